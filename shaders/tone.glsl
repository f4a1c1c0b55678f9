// Linear light to colours of a screen, in display space (sRGB), in [0,1].
//
// Tone: Reinhard et al. 2002, "Photographic tone reproduction", Eq. 4, for each channel:
//     y = x (1 + x / w^2) / (1 + x)    small x pass almost unchanged, x = w becomes white
// Then the sRGB curve of IEC 61966-2-1. The clamp keeps pow away from negative numbers, where it is undefined.
const float WHITE = 4.0;

vec3 tone_mapped(vec3 light) {
    vec3 x = max(light, 0.0);
    return min(x * (1.0 + x / (WHITE * WHITE)) / (1.0 + x), 1.0);
}

vec3 srgb_from_linear(vec3 linear) {
    vec3 x = clamp(linear, 0.0, 1.0);
    return mix(1.055 * pow(x, vec3(1.0 / 2.4)) - 0.055, 12.92 * x, lessThanEqual(x, vec3(0.0031308)));
}
