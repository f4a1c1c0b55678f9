"""One HTML page that draws an avatar by itself, in WebGL2: offline, from anywhere, without asking anyone for anything.

essl.py       shaders/ as GLSL ES 3.00, in the variant of each view mode
packing.py    geometry, textures and motion as the bytes of a page
page.py       all of it as text, in frame.html
page.js       what every page has: elements, failures, its address
unpack.js     the bytes as arrays and images
posing.js     bones of a pose before a camera, in double precision
drawing.js    WebGL2: programs, meshes, textures, frames
orbit.js      the camera under the reader's hands
viewer.js     what the reader touches: time, view modes, settings in the URL
"""
