"""Any bytes from outside: whole files and folders, NPZ, pickles, pictures. NumPy and Pillow only."""
