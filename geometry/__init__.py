"""Meshes and points: normals, sampling, closest points, registration, iso-surfaces, decimation. No torch, no person."""
