#version 330
// The floor: one color, or with CHECKS checks of two, opaque in the middle and gone at its edge. Premultiplied.
//
// Checks are averaged over the pixel's box: the integral of a triangle wave's derivative, so that far ones are an even
// grey and nothing flickers.
uniform vec3 paint;   // sRGB
#if CHECKS != 0
uniform float other;  // of the other checks: share of the paint
uniform float check;  // metres a side
#endif
uniform vec2 fade;    // metres from the anchor: opaque to here, nothing from there

in vec2 place;

out vec4 color;

vec2 wave(vec2 p) {
    return abs(fract(0.5 * p) - 0.5);
}

void main() {
    float alpha = 1.0 - smoothstep(fade.x, fade.y, length(place)), share = 1.0;
#if CHECKS != 0
    vec2 p = place / check;
    // a floor keeps the division finite where the camera is very near
    vec2 w = max(fwidth(p), 1e-5);
    vec2 mean = 2.0 * (wave(p - 0.5 * w) - wave(p + 0.5 * w)) / w;
    share = mix(1.0, other, 0.5 - 0.5 * mean.x * mean.y);
#endif
    color = vec4(paint * share * alpha, alpha);
}
