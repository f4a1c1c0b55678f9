"""pyrender: EGL, one directional light, no shadows. It has no way to change a mesh's points: a new mesh a frame.

Its antialiasing (MSAA 4) cannot be turned off. Default: the mesh comes from trimesh, which computes normals.
"""

import os

os.environ["PYOPENGL_PLATFORM"] = "egl"

import numpy as np
import trimesh
from turns import GREY, serve

# pyrender 0.1.45 asks NumPy 1 for it, while it is imported
np.__dict__["infty"] = np.inf


def make(body, lightest):
    import pyrender

    scene = pyrender.Scene(bg_color=[0, 0, 0, 0], ambient_light=[0.3, 0.3, 0.3])
    camera = pyrender.IntrinsicsCamera(body.K[0, 0], body.K[1, 1], body.K[0, 2], body.K[1, 2], znear=0.1, zfar=50)
    scene.add(camera, pose=body.world_from_view)
    scene.add(pyrender.DirectionalLight(intensity=3.0), pose=body.world_from_view)
    material = pyrender.MetallicRoughnessMaterial(baseColorFactor=(*GREY, 1.0), metallicFactor=0.0)
    renderer = pyrender.OffscreenRenderer(body.width, body.height)
    shown = [None]

    def draw(number):
        if shown[0] is not None:
            scene.remove_node(shown[0])
        if lightest:
            primitive = pyrender.Primitive(
                positions=body.vertices[number],
                normals=body.normals[number],
                indices=body.faces,
                material=material,
            )
            mesh = pyrender.Mesh([primitive])
        else:
            given = trimesh.Trimesh(body.vertices[number], body.faces, process=False)
            mesh = pyrender.Mesh.from_trimesh(given, material=material)
        shown[0] = scene.add(mesh)
        color, _ = renderer.render(scene)
        return color

    return draw, {"name": "pyrender", "version": pyrender.__version__, "settings": "EGL, MSAA 4"}


serve(make)
