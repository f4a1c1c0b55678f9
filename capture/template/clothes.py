"""Clothes that stand off the template: carved from the body video's masks and joined to the template as a shell.

A surface is looked for within a band of centimetres round the template. A skirt, wide trousers or a coat lie beyond it.
As hair is (hull.py), they are carved: what nearly all masks hold is the person, and what of that stands farther
off the template than the band reaches, two litres or more of it, is cloth. Cloth is thin and open below, so of what is
carved only a shell stays, as thick as a grid can hold: with D the signed distance to the air beside what is held, level
by level, and d that to the template,

    max(D, min(-D - THICK, d - D - THICK - GAP), -d - UNDER)

so that the way in from below and the legs inside stay as they are; where less than GAP of air is left between shell and
body, at the waist, the shell is filled down to the skin. Joined to the template it is marched to, learned, skinned and
baked like skin; the band then follows the cloth. It moves as the nearest bones do, smoothed over a hand's breadth of
cloth, so that the middle of a skirt moves half with each leg.

All is carved in the pose that the video holds, where the person is rigid, and taken to the canonical frame by the
weights.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy import ndimage, sparse

from avatar.body import builtin_body
from avatar.skeleton import BIG_POSE, JOINTS, PARTS, skin_transforms
from avatar.skinning import SkinWeights, dense_weights, skin_points, strongest_four, unskin_points
from capture.folder import CaptureSubject, PartVideo
from capture.template.grid import DistanceGrid, closed_surface, distance_grid, trilinear
from capture.template.hull import SEEN_BY, MaskView, background_share, large_pieces, mask_views
from capture.template.surface import SurfaceCloud, surface_cloud, visible_faces
from geometry.cells import distance_to
from geometry.mesh import TriangleMesh, compact, neighbour_matrix

CELL = 0.01  # metres, the template's distance
FINE = 0.007  # metres, the grid on which cloth is carved
# metres off the template: nearer is left to the band, farther no cloth stands
STANDS_OFF, FARTHEST = 0.03, 0.28
# a piece of less is a fold, a pocket, or what masks of two legs leave open; cubic metres, and metres at its farthest
LEAST, REACHES = 2e-3, 0.05
LEAST_SHELL = 2e-4  # cubic metres: less of a shell is what is left between two legs
# a cell is empty when more of the views show background there; of round cloth a tenth would leave half a centimetre
AGAINST = 0.06
# metres: so far round what stands off cloth is followed down to the skin
AROUND = 0.12
# directions round the middle of a level; cloth reaches as far as it does at its widest, or nearly, in as many as at
# the best level, or nearly: less is below the hem
SECTORS, HEM_REACH, ALL_ROUND = 24, 0.6, 0.8
HEM_STEP = 0.004  # metres, in which a hem is followed down from there
# metres, of the shell: a fine cell and a half, or the grid loses it; half of it is the widest cell of the distance that
# the field begins with
THICK = 0.011
# metres of air between shell and skin that are filled, and how deep under the skin the shell ends
GAP, UNDER = 0.02, 0.015
# metres below a hem from which, and over which, a leg is as thick as outlines say, and above it, where hips lie on the
# cloth; vertices at least of a ring of it
BELOW, ABOVE, RING = 0.1, 0.08, 30
LEGS = [[JOINTS.index(f"{side}_{joint}") for joint in ("hip", "knee", "ankle")] for side in ("left", "right")]
# metres of cloth over which skin weights are smoothed
BLEND = 0.1


class Cloth(NamedTuple):
    """A shell of cloth on a grid of the pose that it was carved in."""

    distance: Float[Array, "x y z"]  # signed, metres; right near the shell
    # how deep under the outside of person and cloth together, level by level; metres; 0 farther off than cloth reaches
    depth: Float[Array, "x y z"]
    low: Float[Array, "3"]  # place of distance[0, 0, 0], metres


def with_clothes(subject: CaptureSubject, body: PartVideo, *, drawn_out: bool = False) -> CaptureSubject:
    """The subject with loose clothes joined to its template; the subject itself, bit by bit, where there are none.

    Template faces inside the cloth are dropped; vertices keep their numbers. Clothes belong to the body part.
    `drawn_out`: outlines moved the template, so a skirt's drew out the legs under it.

    Raises:
        ValueError: there are clothes, and the pose that the video holds does not lead to the canonical one.
    """
    pose, views = held_pose(body, subject)
    canonical_to_pose = skin_transforms(pose, subject.joints, np.zeros(3))
    canonical_from_rest = skin_transforms(BIG_POSE, subject.joints, rest=np.zeros((52, 3)))
    posed = replace(subject, vertices=skin_points(subject.vertices, subject.skin, canonical_to_pose))
    cloud = surface_cloud(posed, PARTS.index("body"), visible_faces(subject), CELL, CELL)
    margin = np.array([FARTHEST + 0.02, 0.06, FARTHEST + 0.02])
    low, high = posed.vertices.min(0) - margin, posed.vertices.max(0) + margin
    # twice as wide a grid first, so that people in close clothes cost little
    coarse = distance_grid(cloud, low, high, 2 * CELL)
    loose = standing_off(views, coarse, cloud)
    if not loose.any():
        return subject
    hem = hem_height(views, coarse, loose)
    if drawn_out:
        rest = slim_legs(subject, posed.vertices[:, 1] - hem)
        vertices = skin_points(rest, subject.skin, canonical_from_rest)
        subject = replace(
            subject, rest=rest, vertices=np.where((rest != subject.rest).any(1)[:, None], vertices, subject.vertices)
        )
        posed = replace(subject, vertices=skin_points(subject.vertices, subject.skin, canonical_to_pose))
        cloud = surface_cloud(posed, PARTS.index("body"), visible_faces(subject), CELL, CELL)
    template = distance_grid(cloud, low, high, CELL)
    cloth = carve(views, template, coarse, loose, hem)
    vertices, faces = closed_surface(cloth.distance, cloth.low, FINE, FINE)
    # what of the cloth lies under the skin is no surface, and what of the skin lies in the cloth neither
    under = template.at(vertices[faces].mean(1)).astype(np.float64)
    mesh, _ = compact(vertices, faces[under > -0.003])
    covered = trilinear(cloth.distance, cloth.low, FINE, posed.vertices[subject.faces].mean(1), 1.0) < -0.25 * FINE
    depth = lambda points: trilinear(cloth.depth, cloth.low, FINE, points, 0.0)
    behind = [depth(posed.vertices) > THICK, depth(mesh.vertices) > 0.5 * THICK]
    skin = cloth_weights(mesh, cloud)
    canonical, settled = unskin_points(mesh.vertices, skin, canonical_to_pose)
    # what the big pose's blend takes to there; other bones' blend, it is not where pose 0 shows it
    rest, fine = unskin_points(canonical, skin, canonical_from_rest)
    if not (settled & fine).all():
        raise ValueError(
            f"in the pose that the body's video holds {(~(settled & fine)).mean():.0%} of them lie between bones that "
            "point opposite ways; poses as filmed have no such place"
        )
    part = np.full(len(rest), PARTS.index("body"))
    placed = TriangleMesh(canonical, mesh.faces)
    joined = subject.joined(subject.faces[~covered], placed, rest, skin, part, hair=False)
    return replace(joined, behind_cloth=np.concatenate(behind))


def held_pose(body: PartVideo, subject: CaptureSubject) -> tuple[Float[Array, "52 3"], list[MaskView]]:
    """The pose that a video holds on average, its pelvis at the origin unturned, and the video's views of it there."""
    assert body.axis_angle is not None and body.root is not None
    pose = body.axis_angle.mean(0)
    pose[0] = 0
    pelvis = skin_transforms(pose, subject.joints, np.zeros(3))[0]
    moved = skin_transforms(body.axis_angle, subject.joints, body.root)[:, 0] @ np.linalg.inv(pelvis)
    return pose, mask_views(body, moved)


def standing_off(views: Sequence[MaskView], template: DistanceGrid, cloud: SurfaceCloud) -> Bool[Array, "x y z"]:
    """Cells of the template's grid that the views hold, farther off the body than a band reaches, in large pieces.

    What lies nearest to head or hands is none of it: hair and fingers have their own ways.
    """
    distance, low = template.values.astype(np.float64), template.low.astype(np.float64)
    asked = np.argwhere((distance > STANDS_OFF) & (distance < FARTHEST))
    asked = asked[_held(low + template.cell * asked, views)]
    row = np.asarray(cloud.tree.query(low + template.cell * asked, workers=-1)[1])
    held = np.zeros(distance.shape, bool)
    held[tuple(asked[cloud.part[row] == PARTS.index("body")].T)] = True
    held = np.asarray(ndimage.binary_opening(held, ndimage.generate_binary_structure(3, 1)), bool)
    return large_pieces(held, template.cell, LEAST, distance >= REACHES)


def slim_legs(subject: CaptureSubject, over: Float[Array, "vertices"]) -> Float[Array, "vertices 3"]:
    """The template in pose 0, its legs under a hem as thick, beside the free body's, as they are below it.

    `over`: metres over the hem. The outline of a skirt is taken for that of the thighs, and draws them out.
    """
    body, rest = builtin_body("male"), subject.rest.copy()
    if not subject.on_free_body:
        return rest
    count = len(body.vertices)
    over, weights = over[:count], dense_weights(subject.skin)[:count]
    for chain in LEGS:
        own = weights[:, chain[:2]].sum(1)
        middle, away = _beside_bones(rest[:count], subject.joints[chain])
        thick = np.linalg.norm(away, axis=1)
        by = thick / np.maximum(np.linalg.norm(_beside_bones(body.vertices, body.joints[chain])[1], axis=1), 1e-4)
        below = (own > 0.5) & (over > -2 * BELOW) & (over < -BELOW)
        if below.sum() < RING:
            continue
        slim = np.minimum(np.median(by[below]) / by, 1)
        share = np.clip(2 * own - 1, 0, 1) * np.clip(np.minimum(over + BELOW, ABOVE - over) / (0.5 * BELOW), 0, 1)
        rest[:count] += (share * (slim - 1))[:, None] * away
    return rest


def _beside_bones(
    points: Float[Array, "n 3"], joints: Float[Array, "3 3"]
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """The nearest place on two bones in a row, and the way from there to each point."""
    found = []
    for start, end in zip(joints[:-1], joints[1:]):
        bone = end - start
        along = np.clip((points - start) @ bone / (bone @ bone), 0, 1)
        found.append(start + along[:, None] * bone)
    nearer = np.argmin([np.linalg.norm(points - places, axis=1) for places in found], 0)
    middle = np.where(nearer[:, None] == 0, *found)
    return middle, points - middle


def carve(
    views: Sequence[MaskView], template: DistanceGrid, coarse: DistanceGrid, loose: Bool[Array, "x y z"], hem: float
) -> Cloth:
    """What the views hold within AROUND of the `loose` cells of the coarse grid, down to the hem, as a shell."""
    near = distance_to(loose) * coarse.cell < AROUND
    index = np.argwhere(near)
    low = coarse.low + coarse.cell * (index.min(0) - 1.0)
    shape = tuple(np.ceil(coarse.cell * (np.ptp(index, axis=0) + 2) / FINE).astype(int) + 1)
    cells = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), -1).reshape(-1, 3)
    distance = template.at(low + FINE * cells).astype(np.float64).reshape(shape)
    above = low[1] + FINE * np.arange(shape[1]) > hem
    asked = np.argwhere((distance > 0) & (distance < FARTHEST) & above[:, None])
    places = low + FINE * asked
    nearest = np.round((places - coarse.low) / coarse.cell).astype(np.int64)
    chosen = near[tuple(np.minimum(nearest, np.array(near.shape) - 1).T)]
    cloth = np.zeros(shape, bool)
    cloth[tuple(asked[chosen].T)] = _held(places[chosen], views)
    return shell(cloth, distance, low.astype(np.float64))


def hem_level(loose: Bool[Array, "x y z"]) -> int:
    """The lowest level of the cells that is cloth all round, as near as the widest level is.

    Under a hem, cameras that look down see legs behind every point before and behind them: masks cannot carve there,
    and what they leave is a tongue before the legs and one behind. Beside the legs they see the air.
    """
    reach = np.zeros((loose.shape[1], SECTORS))
    for level, cells in enumerate(np.moveaxis(loose, 1, 0)):
        sector, away = _sectors(np.argwhere(cells))
        np.maximum.at(reach[level], sector, away)
    around = (reach > HEM_REACH * reach.max(0)).mean(1)
    return int(np.flatnonzero(around >= ALL_ROUND * around.max() - 1e-9)[0])


def hem_height(views: Sequence[MaskView], coarse: DistanceGrid, loose: Bool[Array, "x y z"]) -> float:
    """How far down what is cloth at the hem's level goes on, all round as there, metres."""
    level = hem_level(loose)
    cells = np.argwhere(loose[:, level])
    sector, _ = _sectors(cells)
    places = coarse.low + coarse.cell * np.insert(cells, 1, level, axis=1)
    count = np.maximum(np.bincount(sector, minlength=SECTORS), 1)

    def around(under: float) -> float:
        held = _held(places - [0, under, 0], views)
        return float((np.bincount(sector[held], minlength=SECTORS) > 0.5 * count).mean())

    under, whole = 0.0, around(0.0)
    while under < 2 * coarse.cell and around(under + HEM_STEP) >= ALL_ROUND * whole - 1e-9:
        under += HEM_STEP
    return float(coarse.low[1] + coarse.cell * level - under)


def _sectors(cells: Int[Array, "n 2"]) -> tuple[Int[Array, "n"], Float[Array, "n"]]:
    """In which of SECTORS directions from their middle the cells of a level lie, and how far, cells."""
    away = cells - (cells.mean(0) if len(cells) else 0.0)
    turn = np.arctan2(away[:, 0], away[:, 1]) / (2 * np.pi) + 0.5
    return np.floor(turn * SECTORS).astype(int) % SECTORS, np.hypot(*away.T)


def _held(places: Float[Array, "n 3"], views: Sequence[MaskView]) -> Bool[Array, "n"]:
    against, seen = background_share(places, views)
    return (against <= AGAINST) & (seen >= SEEN_BY)


def shell(cloth: Bool[Array, "x y z"], distance: Float[Array, "x y z"], low: Float[Array, "3"]) -> Cloth:
    """Of what is held beyond the template only what lies near the air beside it, joined to the template where they
    meet; `distance` is the template's.
    """
    person = cloth | (distance <= 0)
    # a step up or down is made so long that every level is on its own
    level = (1.0, 1e6, 1.0)
    inside, outside = (
        np.asarray(ndimage.distance_transform_edt(cells, sampling=level, return_distances=True), np.float64) * FINE
        for cells in (person, ~person)
    )
    depth = np.clip(inside, 0, 1) - np.clip(outside, 0, 4 * THICK) + np.where(person, -0.5, 0.5) * FINE
    depth = ndimage.gaussian_filter(depth, 0.8)
    wall = np.minimum(depth - THICK, depth + distance - THICK - GAP)
    beside = (distance_to(cloth & (depth <= THICK)) - 2) * FINE
    out = np.maximum.reduce([-depth, wall, -distance - UNDER, beside])
    large = large_pieces(out < 0, FINE, LEAST_SHELL, out < 0)
    keep = np.asarray(ndimage.binary_dilation(large, ndimage.generate_binary_structure(3, 3)), bool)
    touched = np.asarray(ndimage.binary_dilation(cloth, iterations=2), bool)
    return Cloth(np.where(keep, out, np.maximum(out, 0.5 * FINE)), np.where(touched, depth, 0), low)


def cloth_weights(mesh: TriangleMesh, cloud: SurfaceCloud) -> SkinWeights:
    """Those of the nearest place of the body, smoothed over the cloth; where cloth meets body they are the body's."""
    away, row = cloud.tree.query(mesh.vertices, workers=-1)
    row = np.asarray(row)
    nearest = dense_weights(cloud.skin.of(row))
    bones = np.flatnonzero(nearest.max(0) > 0.01)
    weights = nearest[:, bones]
    count = len(mesh.vertices)
    edges = neighbour_matrix(mesh.faces, count)
    mean = sparse.diags(1 / np.maximum(np.asarray(edges.sum(1)).ravel(), 1)) @ edges
    # half a step to the neighbours' mean spreads by half an edge squared, a quarter in each of two directions
    start, end = mesh.faces[:, 0], mesh.faces[:, 1]
    edge = float(np.linalg.norm(mesh.vertices[start] - mesh.vertices[end], axis=1).mean())
    given = (np.asarray(away) < 1.5 * CELL)[:, None]
    for _ in range(round(4 * (BLEND / edge) ** 2)):
        weights = np.where(given, nearest[:, bones], 0.5 * weights + 0.5 * (mean @ weights))
    out = np.zeros((count, nearest.shape[1]))
    out[:, bones] = np.where(weights > 0.01, weights, 0)
    return strongest_four(out)
