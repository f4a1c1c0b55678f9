"""Person and room told apart by their colors where no picture shows the room alone: GrabCut, by OpenCV.

Colors of both are mixtures of Gaussians, learned from what is known of the picture, and a cut between them runs along
edges (Rother, Kolmogorov and Blake 2004).
"""

import importlib.util

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy import ndimage

# pixels: height of the pictures that are cut, and what of them may be the person
CUT, MOST = 480, 60_000
ROUNDS = 5
# pixels beside what may be the person whose colors are the room's
BESIDE = 12
# grey levels of noise that is added: else the mixture that has a white wall for itself alone takes all that is white
BLUR = 4.0
INSTALL = "pip install opencv-python-headless"


def can_cut() -> bool:
    """Whether OpenCV is installed."""
    return importlib.util.find_spec("cv2") is not None


def grab_cut(
    image: Float[Array, "height width 3"],
    person: Bool[Array, "height width"],
    near: Bool[Array, "height width"],
    may: Bool[Array, "height width"],
) -> Float[Array, "height width"]:
    """Share of the person at every pixel: 1 on `person`, 0 where it may not be; `near` is what begins as it."""
    import cv2

    height, width = person.shape
    scale = min(1.0, CUT / height, float(np.sqrt(MOST / max(np.count_nonzero(may), 1))))
    size = (round(width * scale), round(height * scale))
    shrunk = lambda pixels: cv2.resize(pixels.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    person, near, may = shrunk(person), shrunk(near), shrunk(may)
    share = (person & may).astype(np.float32)
    if may.any() and not may.all():
        labels = np.where(person, cv2.GC_FGD, np.where(near, cv2.GC_PR_FGD, cv2.GC_PR_BGD))
        labels = np.where(may, labels, cv2.GC_BGD).astype(np.uint8)
        # the rest of the picture only costs time
        window = ndimage.find_objects(np.asarray(ndimage.binary_dilation(may, iterations=BESIDE)).astype(int))[0]
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)[window]
        small = small + np.random.default_rng(0).normal(0, BLUR, small.shape)
        cut, models = np.ascontiguousarray(labels[window]), (np.zeros((1, 65)), np.zeros((1, 65)))
        cv2.setRNGSeed(0)
        colors = np.clip(small, 0, 255).astype(np.uint8)
        cv2.grabCut(colors, cut, (0, 0, 1, 1), *models, ROUNDS, cv2.GC_INIT_WITH_MASK)
        share[window] = (cut == cv2.GC_FGD) | (cut == cv2.GC_PR_FGD)
    return np.asarray(cv2.resize(share, (width, height), interpolation=cv2.INTER_LINEAR))
