"""GLSL only: .glsl is included, .vert and .frag are compiled. Read by player/gl/shader.py."""
