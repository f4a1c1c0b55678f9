"""The trained field drawn by itself, the truth of the model."""
