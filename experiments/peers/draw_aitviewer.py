"""aitviewer: headless window (it needs an X server), no floor, no axes, no shadows. Default: MSAA 4,
its own normals.
"""

from importlib.metadata import version

import numpy as np
from aitviewer.configuration import CONFIG
from turns import GREY, serve

CONFIG.update_conf(
    {"device": "cpu", "shadows_enabled": False, "auto_set_floor": False, "auto_set_camera_target": False,
     "background_color": [0.0, 0.0, 0.0, 1.0]}
)  # fmt: skip


def make(body, lightest):
    # these read the configuration while they are imported
    from aitviewer.headless import HeadlessRenderer
    from aitviewer.renderables.meshes import Meshes
    from aitviewer.scene.camera import OpenCVCamera

    viewer = HeadlessRenderer(size=(body.width, body.height), samples=0 if lightest else 4)
    viewer.scene.floor.enabled = False
    viewer.scene.origin.enabled = False
    viewer.shadows_enabled = False
    mesh = Meshes(
        body.vertices, body.faces, vertex_normals=body.normals if lightest else None,
        color=(*GREY, 1.0), cast_shadow=False,
    )  # fmt: skip
    camera = OpenCVCamera(body.K, body.camera_from_world[:3], body.width, body.height, near=0.1, far=50)
    viewer.scene.add(mesh, camera)
    viewer.scene.camera = camera

    def draw(number):
        viewer.scene.current_frame_id = number
        return np.asarray(viewer.get_frame())

    settings = f"Xvfb, {viewer.samples} samples"
    return draw, {"name": "aitviewer", "version": version("aitviewer"), "settings": settings}


serve(make)
