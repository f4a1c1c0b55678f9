"""What moves a face where no one acts it: life without input (life.py) and the sound of speech (speech.py).

Functions of time alone: a film repeats, and any frame of it can be made first. Nothing here knows of windows or OpenGL.
"""
