"""From keypoints and masks of four videos to a person: shape and poses of the free body, and the cameras."""
