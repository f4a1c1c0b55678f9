"""Training: a capture folder becomes four part fields and their composition (TotalSelfScan, section 3). Needs torch."""
