#version 330
// What the lamp does not reach, and how near to the ground the lowest that is in its way is. Blended by the maximum.

in float height;

out vec2 mask;

void main() {
    mask = vec2(1.0, 1.0 - clamp(height, 0.0, 1.0));
}
