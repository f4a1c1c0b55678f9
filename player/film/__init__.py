"""Films and pictures: what is drawn at each frame, parts that go on after a stop, encoders, clusters."""
