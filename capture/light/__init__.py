"""The light of a capture, told from what the posed template shows of its videos."""
