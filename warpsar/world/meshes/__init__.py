"""Readers of mesh files, one a format: each gives the file's parts as they stand there.

part: what a reader gives. through_trimesh: files that trimesh reads. obj, ply, stl, gltf, dem: the formats.
"""
