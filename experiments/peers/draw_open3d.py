"""Open3D (Filament): off screen, geometry removed and added a frame, no shadows.

0.19.0, which draws by OpenGL: 0.20.0 wants Vulkan, and on Mesa's software device stops after a few frames.
"""

import os

os.environ.setdefault("EGL_PLATFORM", "surfaceless")

import numpy as np
import open3d as o3d
from open3d.visualization import rendering
from turns import GREY, serve


def make(body, lightest):
    renderer = rendering.OffscreenRenderer(body.width, body.height)
    scene = renderer.scene
    scene.set_background([0, 0, 0, 1])
    scene.set_lighting(scene.LightingProfile.NO_SHADOWS, np.float32(body.forward))
    if lightest:
        scene.view.set_antialiasing(False)
        scene.view.set_post_processing(False)
    scene.view.set_shadowing(False, scene.view.ShadowType.PCF)
    material = rendering.MaterialRecord()
    material.shader, material.base_color = "defaultLit", (*GREY, 1.0)
    faces = o3d.utility.Vector3iVector(body.faces)
    aimed = [False]

    def draw(number):
        mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(body.vertices[number].astype(float)), faces)
        if lightest:
            mesh.vertex_normals = o3d.utility.Vector3dVector(body.normals[number].astype(float))
        else:
            mesh.compute_vertex_normals()
        scene.clear_geometry()
        scene.add_geometry("body", mesh, material)
        # before there is geometry it would derive clip planes that hide everything
        if not aimed[0]:
            lens = o3d.camera.PinholeCameraIntrinsic(body.width, body.height, body.K)
            renderer.setup_camera(lens, body.camera_from_world)
            aimed[0] = True
        return renderer.render_to_image()

    return draw, {
        "name": "Open3D", "version": o3d.__version__,
        "settings": "EGL, no post-processing" if lightest else "EGL, FXAA, tone mapping",
    }  # fmt: skip


serve(make)
