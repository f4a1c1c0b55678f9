#version 330
// See picture.vert. The picture as a lens without distortion had taken it (Brown 1971, as avatar/camera.py), or a
// plain colour. Opaque; black where the lens saw nothing.

uniform sampler2D picture;
uniform vec4 plain;        // rgb instead of the picture where a = 1
uniform vec4 lens;         // fx, fy, cx, cy over width and height: 0..1 of the picture
uniform vec4 distortion;   // k1 k2 p1 p2
uniform vec2 more;         // k3, skew / width

in vec2 place;

out vec4 color;

void main() {
    float y = (place.y - lens.w) / lens.y;
    float x = (place.x - lens.z - more.y * y) / lens.x;
    float r2 = x * x + y * y;
    float radial = 1.0 + r2 * (distortion.x + r2 * (distortion.y + r2 * more.x));
    float xd = x * radial + 2.0 * distortion.z * x * y + distortion.w * (r2 + 2.0 * x * x);
    float yd = y * radial + distortion.z * (r2 + 2.0 * y * y) + 2.0 * distortion.w * x * y;
    vec2 at = vec2(lens.x * xd + more.y * yd + lens.z, lens.y * yd + lens.w);
    vec2 inside = step(vec2(0.0), at) * step(at, vec2(1.0));
    vec3 seen = texture(picture, at).rgb * inside.x * inside.y;
    color = vec4(mix(seen, plain.rgb, plain.a), 1.0);
}
