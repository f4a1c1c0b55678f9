"""Drawing in a given time: the most exact way that holds it, measured here.

ladder.py       the ways avatars and scenes can be drawn, and which of them a budget buys
measure.py      what each costs on this machine, and how it differs from the best
table.py        both, kept in the user's cache folder for this machine and these avatars
controller.py   which one a window shows, frame by frame
"""
