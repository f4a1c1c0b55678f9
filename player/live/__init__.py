"""Live poses: from the network into the window, from a file onto the network, and how late they are.

A datagram becomes a frame (`osc` and `vmc`, or `json_pose`), frames wait in an `inbox` that a `receiver` thread
fills, and the `playback` takes one each time the window draws: turned into our pose (`calibration`), smoothed
(`one_euro`), recorded (`take`) and timed (`latency`). `command` sends a motion out again.

Nothing that arrives is trusted: sizes, counts, depths and numbers are bounded, and nothing is ever unpickled.
"""
