#version 330
// Antialiasing of a finished picture: fast approximate antialiasing, T. Lottes 2009 (the five-tap form). Where the
// four diagonal neighbours differ enough from the pixel, colours are averaged along the edge they show.
//
// Reads the avatars as drawn over nothing, in display space, after all shading; the result is blended over the
// background, which stays as sharp as it is. All four channels are averaged alike, so premultiplied colours stay
// premultiplied.
//
// The edge signal is luma + alpha, not luma: a black sleeve on a transparent ground has an edge, too. Inside an
// avatar alpha is 1 and the signal is Lottes' luma, raised by 1.

uniform sampler2D picture;  // bilinear, clamped at its border

out vec4 color;

const float LEAST = 1.0 / 24.0;    // contrast that is no edge: noise and dark gradients
const float RELATIVE = 1.0 / 8.0;  // the same, as a share of the brightest neighbour's luma
const float REDUCE_LEAST = 1.0 / 128.0;  // keeps the direction finite where the four corners agree
const float REDUCE = 1.0 / 8.0;
const float REACH = 8.0;  // pixels along the edge at most

float signal(vec4 c) {
    return dot(c.rgb, vec3(0.299, 0.587, 0.114)) + c.a;
}

float signal_at(ivec2 pixel, ivec2 last) {
    return signal(texelFetch(picture, clamp(pixel, ivec2(0), last), 0));
}

void main() {
    ivec2 size = textureSize(picture, 0), pixel = ivec2(gl_FragCoord.xy), last = size - 1;
    vec4 here = texelFetch(picture, pixel, 0);
    float middle = signal(here);
    float nw = signal_at(pixel + ivec2(-1, -1), last), ne = signal_at(pixel + ivec2(1, -1), last);
    float sw = signal_at(pixel + ivec2(-1, 1), last), se = signal_at(pixel + ivec2(1, 1), last);  // n: y - 1
    float low = min(middle, min(min(nw, ne), min(sw, se)));
    float high = max(middle, max(max(nw, ne), max(sw, se)));
    if (high == 0.0) {
        discard;  // no avatar near
    }
    if (high - low < max(LEAST, RELATIVE * (high - 1.0))) {
        color = here;
        return;
    }
    vec2 along = vec2((sw + se) - (nw + ne), (nw + sw) - (ne + se));
    float reduce = max(0.25 * REDUCE * (nw + ne + sw + se - 4.0 * low), REDUCE_LEAST);
    along = clamp(along / (min(abs(along.x), abs(along.y)) + reduce), -REACH, REACH) / vec2(size);
    vec2 place = gl_FragCoord.xy / vec2(size);
    vec4 near = 0.5 * (texture(picture, place - along / 6.0) + texture(picture, place + along / 6.0));
    vec4 far = 0.5 * near + 0.25 * (texture(picture, place - 0.5 * along) + texture(picture, place + 0.5 * along));
    float found = signal(far);
    color = found < low || found > high ? near : far;  // the far taps crossed into something else
}
