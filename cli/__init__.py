"""The command line: a file for each command, which imports its work only when it runs.

main: the group `warpsar`. options: options that several commands share.
"""
