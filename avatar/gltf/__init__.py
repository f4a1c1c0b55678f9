"""glTF 2.0 files, and the avatar file, which is one."""
