"""Training: from a capture folder to four part fields and their composition (TotalSelfScan, section 3). Needs torch."""
