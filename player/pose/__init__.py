"""Posing by hand, in NumPy alone: joint limits, IK, fingers, mirror, gizmo, the session with its undo, the library.

Nothing here draws or knows the window. A pose is (axis-angle (52, 3), root (3,)): parent_from_joint rotations in
radians with flat hands as zero, and the pelvis joint in the world, +y up, metres.
"""
