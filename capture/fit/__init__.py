"""From keypoints and masks of videos to a person: shape and poses of the free body, and the cameras."""
