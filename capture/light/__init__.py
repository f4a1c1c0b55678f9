"""The light of a capture, estimated from what the posed template shows of its videos."""
