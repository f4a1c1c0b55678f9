"""Part fields -> avatar file: one mesh per level, one atlas each, skin weights, a tiny view network.

    surface   fused field -> closed triangle mesh on its zero set, finer at head and hands
    decimate  the same surface with few triangles, still closed and manifold
    atlas     charts and their packing (a separate process with bounded time)
    texels    texel -> canonical point; base color at the global view direction (paper, Eq. 14)
    transfer  closest points between two meshes of one person, never across to the other side
    skin      four 8-bit weights per vertex that sum to exactly 255
    cone      per-vertex global view direction, tangent metric Q and visibility v (FRAMES, "View statistics")
    network   view-dependent residual inside that cone: 8 -> 16 -> 3, or linear, or none
    promises  what a bake promises, and what to do where it missed
    measure   what was lost: baked avatar against field, in images
    field     the run's field behind NumPy functions
    level     one level of detail out of the pieces above
    bake      all of it in order; options are its settings, command its command line

Everything is in the canonical frame (the subject's big pose, pelvis at the origin, metres).
"""
