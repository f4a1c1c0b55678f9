"""Places of the body that no video saw, in words, and what to film: their texture is a guess."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from avatar.skeleton import PARTS
from avatar.skinning import SkinWeights
from capture.check.coverage import ENOUGH
from capture.check.silhouette import canonical_from_head
from capture.folder import Capture
from capture.template.views import part_views
from geometry.mesh import face_areas, face_normals, vertex_normals

# heaviest joint of a vertex to the limb it is on, with the name of one and of both
LIMBS = {
    "head": ((15,), (), "the head", ""),
    "neck": ((12,), (), "the neck", ""),
    "torso": ((0, 3, 6, 9, 13, 14), (), "the torso", ""),
    "upper arm": ((16,), (17,), "upper arm", "both upper arms"),
    "forearm": ((18,), (19,), "forearm", "both forearms"),
    "hand": ((20, *range(22, 37)), (21, *range(37, 52)), "hand", "both hands"),
    "thigh": ((1,), (2,), "thigh", "both thighs"),
    "shin": ((4,), (5,), "shin", "both shins"),
    "foot": ((7, 10), (8, 11), "foot", "both feet"),
}
# sides of a limb by where its surface faces in the T-pose (+y up, +z front), one and several, and how to see them
SIDES = {
    "top": ((0, 1, 0), "the top of", "the tops of", "hold the phone higher"),
    "underside": ((0, -1, 0), "the underside of", "the undersides of", "hold the phone lower"),
    "front": ((0, 0, 1), "the front of", "the fronts of", "turn all the way round"),
    "back": ((0, 0, -1), "the back of", "the backs of", "turn all the way round"),
    "side": ((1, 0, 0), "the side of", "the sides of", "turn all the way round, arms away from the body"),
}
# share of a side that was hardly seen, and square metres of it, from which it is worth a word
SHARE, AREA = 0.2, 0.0015
# places that are named
MOST = 6


@dataclass(frozen=True)
class UnseenPlace:
    """A side of one limb, or of both, that was hardly seen."""

    what: str
    area: float  # square metres seen in fewer than ENOUGH frames
    advice: str

    def line(self) -> str:
        return f"{self.what} hardly seen ({self.area * 1e4:.0f} cm²): {self.advice}"


def frames_that_see(capture: Capture) -> Float[Array, "vertices"]:
    """For each vertex of the template, in how many frames of the videos it is seen: the body's, and each close-up's of
    its own part."""
    subject = capture.subject
    normals = vertex_normals(subject.vertices, subject.faces)
    total = np.zeros(len(subject.vertices))
    for index, part in enumerate(PARTS):
        transform = canonical_from_head(capture) if part == "head" else None
        own = np.ones(len(total), bool) if part == "body" else subject.part == index
        sums = part_views(capture.videos[part], subject, subject.vertices, normals, subject.skin, own, transform)
        total += sums.count
    return total


def unseen_places(
    vertices: Float[Array, "vertices 3"],
    faces: Int[Array, "faces 3"],
    skin: SkinWeights,
    frames: Float[Array, "vertices"],
    visible: Bool[Array, "faces"] | None = None,
) -> tuple[UnseenPlace, ...]:
    """Sides of limbs of which much was hardly seen, the largest first, of a body in T-pose or nearly so.

    `frames` are how many see each vertex, `visible` the faces that can be seen at all (all of them for None).
    """
    area = face_areas(vertices, faces) * (1 if visible is None else visible)
    cosine = face_normals(vertices, faces) @ np.array([direction for direction, *_ in SIDES.values()], np.float64).T
    # left and right are one side
    cosine[:, -1] = np.abs(cosine[:, -1])
    facing = cosine.argmax(1)
    missed = (frames < ENOUGH)[faces].mean(1)
    joint = skin.heaviest[faces[:, 0]]
    found = []
    for name, (left, right, one, both) in LIMBS.items():
        for number, (side, (_, singular, plural, advice)) in enumerate(SIDES.items()):
            # a person stands on the soles
            if (name, side) == ("foot", "underside"):
                continue
            areas = []
            for joints in (left, right):
                own = area * (facing == number) * np.isin(joint, joints)
                lost = float((own * missed).sum())
                # little is nothing
                areas.append(lost if lost > AREA and lost > SHARE * own.sum() else 0.0)
            if all(areas):
                found.append(UnseenPlace(f"{plural} {both} were", sum(areas), advice))
            elif any(areas):
                which = "" if not right else "the left " if areas[0] else "the right "
                found.append(UnseenPlace(f"{singular} {which}{one} was", sum(areas), advice))
    return tuple(sorted(found, key=lambda place: -place.area)[:MOST])
