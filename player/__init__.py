"""Avatar file to pixels: contexts, shaders, the plan of passes, films and the window. Never imports torch."""
