"""The four videos as a phone writes them, with a room, sway, noise and a detector's keypoints."""
