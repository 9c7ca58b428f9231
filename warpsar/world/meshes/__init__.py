"""Readers of mesh files, one a format: each gives the file's parts as they stand there.

part: what a reader gives. through_trimesh: files that trimesh reads. broken_lines: what is wrong in a
file of text, and where. obj, ply, stl, gltf, dem: the formats.
"""
