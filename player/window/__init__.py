"""The window program: time, cameras, mouse and keys, picking, the wipe against a video, what is recorded."""
