"""The capture folder: its format, readers of foreign layouts, repair of masks and poses,
and `selfscan check`. No torch.
"""
