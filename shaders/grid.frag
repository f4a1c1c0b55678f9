#version 330
// Lines on the ground: every metre, thinner ones between. Premultiplied.
//
// A line of the width of a pixel's footprint or more, its cover averaged over that footprint: far lines fade into an
// even tone and do not flicker.
uniform vec3 paint;    // sRGB
uniform float spacing; // metres
uniform float width;   // pixels
uniform vec2 origin;   // of the world about the anchor, x and z, metres
uniform vec2 fade;     // metres from the anchor: as strong as it is to here, nothing from there

in vec2 place;

out vec4 color;

float lines(vec2 p, float step) {
    vec2 q = p / step;
    vec2 pixel = max(fwidth(q), 1e-6);
    vec2 off = abs(fract(q - 0.5) - 0.5) / pixel;  // from the nearest line, pixels
    // half a pixel about the line's edge; where lines lie closer than pixels, their share of the ground
    vec2 cover = clamp(0.5 * width + 0.5 - off, 0.0, 1.0);
    cover = mix(cover, min(width * pixel, vec2(1.0)), smoothstep(0.3, 0.6, pixel));
    return 1.0 - (1.0 - cover.x) * (1.0 - cover.y);
}

void main() {
    vec2 p = place - origin;
    float alpha = max(0.8 * lines(p, spacing), 0.3 * lines(p, 0.2 * spacing));
    alpha *= 1.0 - smoothstep(fade.x, fade.y, length(place));
    color = vec4(paint * alpha, alpha);
}
