"""What baking lost: avatar file drawn by the player against the field drawn as its first surface crossing."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.ndimage import binary_erosion

from avatar.camera import Camera, orbit_camera, pixel_rays
from avatar.gltf.avatar_file import Avatar
from avatar.psnr import PooledError, error_between, pooled
from avatar.rotation import unit_or_zero
from avatar.skeleton import joint_transforms, skin_transforms
from avatar.skinning import SkinWeights, blended_rotations, skin_points, strongest_four
from bake.cone import ViewCone, clamped_tangent, cone_direction, interpolated
from bake.field import NumpyField
from geometry.isosurface import PointFunction, project_to_zero
from geometry.mesh import TriangleMesh, blended
from geometry.sample import stratified_samples

HEAD = 15
LEFT_MIDDLE, RIGHT_MIDDLE = 25, 40


def scored_mask(mask: Bool[Array, "height width"]) -> Bool[Array, "height width"]:
    """The mask eroded by one pixel: silhouettes differ by a fraction of a pixel in any two rasterisers."""
    return binary_erosion(mask, np.ones((3, 3), bool), border_value=0)


class ScoredView(NamedTuple):
    """A pose and a camera to compare pictures from."""

    name: str
    axis_angle: Float[Array, "52 3"]
    root: Float[Array, "3"]
    camera: Camera
    # or novel_pose: scores are kept apart by it
    group: str = "novel_view"


class FieldSurface(NamedTuple):
    """The fine mesh of the field with all that is needed to draw the field in any pose."""

    mesh: TriangleMesh
    normals: Float[Array, "vertices 3"]
    skin: SkinWeights
    cone: ViewCone
    joints: Float[Array, "52 3"]
    field: NumpyField


def test_poses() -> dict[str, Float[Array, "52 3"]]:
    """Poses that the bake is scored in: the T-pose, and one that bends what bends, fingers included."""
    rest = np.zeros((52, 3))
    bent = np.zeros((52, 3))
    bent[16], bent[17] = (0, 0, -0.9), (0, 0, 0.7)  # shoulders
    bent[18], bent[19] = (0, -0.8, 0), (0, 0.5, 0)  # elbows
    bent[1], bent[4] = (-0.5, 0, 0), (0.7, 0, 0)  # left hip and knee
    bent[15] = (0, 0.3, 0)
    for first, sign in ((22, -1.0), (37, 1.0)):
        for finger in range(4):
            for link in range(3):
                bent[first + 3 * finger + link] = (0, 0, sign * 0.12 * (finger + 1))
    return {"t": rest, "bent": bent}


def test_views(joints: Float[Array, "52 3"], size: int = 512) -> list[ScoredView]:
    """Whole body from four sides and close-ups of head and hands, in both poses.

    Training saw the T-pose, if under other cameras (novel views); the bent one it never saw (novel poses).
    """
    views = []
    for pose_name, pose in test_poses().items():
        group = "novel_view" if pose_name == "t" else "novel_pose"
        world = joint_transforms(pose, joints, np.zeros(3))[:, :3, 3]
        middle = 0.5 * (world.max(0) + world.min(0))
        reach = 1.45 * float((world.max(0) - world.min(0)).max())
        for i, azimuth in enumerate((0.35, 2.0, 3.6, 5.2)):
            if (i % 2) == (pose_name == "bent"):
                camera = orbit_camera(middle, max(reach, 1.0) * 1.25, azimuth, 0.05, (size, size))
                views.append(ScoredView(f"{pose_name} body {azimuth:g}", pose, np.zeros(3), camera, group))
        head = orbit_camera(world[HEAD] + np.array([0.0, 0.07, 0.0]), 0.75, 0.4, 0.1, (size, size))
        views.append(ScoredView(f"{pose_name} head", pose, np.zeros(3), head, group))
        for side, middle_joint, azimuth in (("left", LEFT_MIDDLE, 0.6), ("right", RIGHT_MIDDLE, -0.6)):
            camera = orbit_camera(world[middle_joint], 0.55, azimuth, 0.5, (size, size))
            views.append(ScoredView(f"{pose_name} {side} hand", pose, np.zeros(3), camera, group))
    return views


class FieldImage(NamedTuple):
    paper: Float[Array, "height width 3"]  # [0, 1], field at d_bar
    # field at d', where asked
    cone: Float[Array, "height width 3"] | None
    mask: Bool[Array, "height width"]


def draw_field(
    surface: FieldSurface, view: ScoredView, draw: Callable[[Array, Array, Camera], tuple[Array, Array]], *,
    with_cone: bool,
) -> FieldImage:  # fmt: skip
    """The field as its first surface crossing: the fine mesh posed and rasterised, each pixel's canonical point
    moved onto the zero set, its color asked there. draw(vertices_world, faces, camera) -> face, barycentric."""
    transforms = skin_transforms(view.axis_angle, surface.joints, view.root)
    posed = skin_points(surface.mesh.vertices, surface.skin, transforms)
    face, barycentric = draw(posed, surface.mesh.faces, view.camera)
    mask = face >= 0
    corners, weight = surface.mesh.faces[face[mask]], np.clip(barycentric[mask].astype(np.float64), 0, 1)
    points = blended(surface.mesh.vertices, corners, weight)
    normals = unit_or_zero(blended(surface.normals, corners, weight))
    points, _ = project_to_zero(surface.field.distance, points, normals, reach=0.003, steps=2)
    cone = interpolated(surface.cone, corners, weight)
    paper = np.zeros((*mask.shape, 3))
    paper[mask] = surface.field.color(points, cone.direction)
    if not with_cone:
        return FieldImage(paper, None, mask)
    dense = np.zeros((len(corners), len(transforms)))
    for corner in range(3):
        joints, share = surface.skin.of(corners[:, corner])
        np.add.at(dense, (np.arange(len(dense))[:, None], joints), share * weight[:, corner, None])
    rotation = blended_rotations(strongest_four(dense), transforms)
    _, rays = pixel_rays(view.camera)
    direction = np.einsum("nji,nj->ni", rotation, rays.reshape(*mask.shape, 3)[mask])
    image = np.zeros((*mask.shape, 3))
    image[mask] = surface.field.color(points, cone_direction(clamped_tangent(direction, cone), cone))
    return FieldImage(paper, image, mask)


class BakeScore(NamedTuple):
    """PSNR in decibels over the eroded masks; infinite where pictures are the same."""

    # baked paper mode against the field at d_bar, pooled over all views
    paper_db: float
    # each mode against the cone field, pooled
    view_db: dict[str, float]
    # the same by group of views: paper mode against d_bar is "paper"
    group_db: dict[str, dict[str, float]]
    per_view: dict[str, float]  # paper mode, by view
    pixels: int


def compare(avatar: Avatar, surface: FieldSurface, views: list[ScoredView]) -> BakeScore:
    """Draw every view of field and file, in all modes that the file holds, and score them."""
    from player.draw.raster import Rasteriser
    from player.effects.avatar import views_of
    from player.gl.context import open_context
    from player.scene.renderer import Renderer

    modes = views_of(avatar)[::-1]
    errors = {view.group: dict.fromkeys(["paper", *modes], PooledError()) for view in views}
    per_view = {}
    with open_context() as context:
        rasteriser = Rasteriser(context)

        def draw(vertices: Array, faces: Array, camera: Camera) -> tuple[Array, Array]:
            fragments = rasteriser.draw(vertices, faces, camera)
            return fragments.face, fragments.barycentric

        renderers = {mode: Renderer(context, [avatar], views[0].camera.size, view=mode) for mode in modes}
        # each is scored before the next: pictures of many views would fill the memory
        for view in views:
            field = draw_field(surface, view, draw, with_cone=len(modes) > 1)
            inside, into = scored_mask(field.mask), errors[view.group]
            for mode, renderer in renderers.items():
                image = renderer.draw([(view.axis_angle, view.root)], view.camera)[..., :3] / 255.0
                if mode == "off":
                    error = error_between(image, np.round(field.paper * 255) / 255, inside)
                    into["paper"] = into["paper"].plus(error)
                    per_view[view.name] = error.psnr()
                if field.cone is not None:
                    into[mode] = into[mode].plus(error_between(image, field.cone, inside))
        for renderer in renderers.values():
            renderer.release()
        rasteriser.release()
    groups = {group: {m: e.psnr() for m, e in one.items() if e.count} for group, one in errors.items()}
    together = {m: pooled(one[m] for one in errors.values()) for m in ["paper", *modes]}
    db = {mode: e.psnr() for mode, e in together.items() if e.count}
    paper = db.pop("paper", float("nan"))
    return BakeScore(paper, db, groups, per_view, together["paper"].count // 3)


def field_to_mesh(distance: PointFunction, mesh: TriangleMesh) -> Float[Array, "count"]:
    """|distance| of points spread evenly over a mesh, metres: how far its triangles cut through the surface."""
    return np.abs(distance(stratified_samples(*mesh, 40_000, seed=0).on(*mesh)))
