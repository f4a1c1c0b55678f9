"""PyVista (VTK): off screen, points set in place, smooth shading. Default: normals by VTK's own filter, MSAA."""

import numpy as np
import pyvista
from turns import GREY, serve


def make(body, lightest):
    faces = np.hstack([np.full((len(body.faces), 1), 3), body.faces]).ravel()
    mesh = pyvista.PolyData(body.vertices[0].copy(), faces)
    mesh.point_data.active_normals = body.normals[0].copy()
    if lightest:
        pyvista.global_theme.multi_samples = 1
    plotter = pyvista.Plotter(off_screen=True, window_size=[body.width, body.height], lighting="none")
    if lightest:
        plotter.disable_anti_aliasing()
    else:
        plotter.enable_anti_aliasing("msaa")
    plotter.set_background(color="black")  # pyright: ignore
    actor = plotter.add_mesh(mesh, color=GREY, smooth_shading=True, split_sharp_edges=False)
    plotter.add_light(pyvista.Light(light_type="headlight"))
    plotter.camera.position = body.eye
    plotter.camera.focal_point = body.eye + 3 * body.forward
    plotter.camera.up = -body.camera_from_world[1, :3]
    plotter.camera.view_angle = np.degrees(body.fov_y)
    plotter.camera.clipping_range = (0.1, 50)
    plotter.show(auto_close=False, interactive=False)
    # smooth shading may have made a copy
    drawn = actor.mapper.dataset

    def draw(number):
        drawn.points = body.vertices[number]
        if lightest:
            drawn.point_data["Normals"] = body.normals[number]
        else:
            drawn.compute_normals(cell_normals=False, split_vertices=False, consistent_normals=False, inplace=True)
        plotter.render()
        return plotter.screenshot(return_img=True)

    vtk = ".".join(str(part) for part in pyvista.vtk_version_info)
    assert plotter.render_window is not None
    settings = f"{type(plotter.render_window).__name__}, {plotter.render_window.GetMultiSamples()} samples"
    return draw, {"name": "PyVista", "version": f"{pyvista.__version__} (VTK {vtk})", "settings": settings}


serve(make)
