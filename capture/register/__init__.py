"""The head's place on the body: Eq. 6 and what refines it."""
