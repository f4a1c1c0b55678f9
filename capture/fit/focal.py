"""The focal length of a phone, found from keypoints of all its videos.

Perspective shows it: what is nearer looks larger. Limbs that bend from frame to frame hide nearly all of that, so one
video leaves it open by some per cent. The videos of body, hands and head err independently; each is fitted to keypoints
alone with the focal length free, over more frames than are fitted later, and what they find is weighed by how sure
each is:

    log f = sum_v (x_v / s_v^2 - x_0 / s_0^2) / sum_v (1 / s_v^2 - 1 / s_0^2)     with the guess x_0, s_0 added once

where s_v is the standard deviation of the marginal (the inverse of the normal equations, all other unknowns free).
Videos that contradict each other widen the result (Birge 1932).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from capture.fit import body, hand, head
from capture.fit.footage import Estimate, Footage
from capture.fit.person import Person
from capture.fit.priors import Priors, shared_layout, standing
from capture.fit.solve import assemble


@dataclass(frozen=True)
class Focal:
    shorter_sides: float  # lengths of the picture's shorter side
    sigma: float  # relative standard deviation


def focal_of_videos(person: Person, footages: Mapping[str, Footage], report: body.Report) -> Focal:
    """The focal length of the phone that took all `footages`, with the same guess and deviation in all.

    A footage's masks are not looked at.
    """
    found, guess = [], footages["body"]
    bodily, footage = body.fit_keypoints(person, guess, lambda _: None)
    found.append((bodily.log_focal, marginal(bodily, footage, standing(bodily, footage))))
    report("body")
    for part, footage in footages.items():
        if part == "body":
            continue
        if part == "head":
            estimate, priors = head.fit_keypoints(bodily.person, bodily.g, footage)
        else:
            estimate, priors = hand.fit_keypoints(bodily.person, bodily.g, footage, part.removeprefix("hand_"))
        found.append((estimate.log_focal, marginal(estimate, footage, priors)))
        report(part)
    away, sigma = weighed(np.array(found), guess.focal_sigma)
    return Focal(guess.focal * float(np.exp(away)) / min(guess.size), sigma)


def marginal(estimate: Estimate, footage: Footage, priors: Priors) -> float:
    """Standard deviation of log_focal at a solution, every other unknown free."""
    equations, _ = assemble(estimate, footage, priors, body.CUTS[-1], ())
    focal = shared_layout(estimate, footage).focal
    equations.b[:], equations.b_shared[:] = 0, 0
    equations.b_shared[focal] = 1
    _, column = equations.solve(0.0)
    return float(np.sqrt(column[focal]))


def weighed(found: Float[Array, "videos 2"], guess_sigma: float) -> tuple[float, float]:
    """Mean of values with standard deviations, all of which hold the same guess 0 of standard deviation `guess_sigma`.

    Returns the mean that holds it once, and its standard deviation.
    """
    value, sigma = found.T
    own = np.maximum(1 / sigma**2 - 1 / guess_sigma**2, 0)
    # a video alone says this, without the guess
    alone = value / sigma**2 / np.maximum(own, 1e-12)
    precision = own.sum() + 1 / guess_sigma**2
    mean = float((own * alone).sum() / precision)
    contradiction = float((own * (alone - mean) ** 2).sum() / max(len(found) - 1, 1))
    return mean, float(np.sqrt(max(contradiction, 1.0) / precision))
