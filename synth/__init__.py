"""Self-scan videos of people whose mesh is known: the captures, and the truth to measure against."""
