"""`selfscan inspect`: pictures and one page to judge a baked avatar by."""
