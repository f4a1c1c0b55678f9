"""Contexts, programs, textures and buffers of OpenGL 3.3."""
