// An avatar lit anew: the light that its base colour shows is taken out, another one put in. Mirrors avatar/light.py:
//
//     S(n) = ambient + sum_k strength_k max(n . l_k, 0)
//     H(n, v) = gloss sum_k share_k max(n . h_k, 0)^exponent,  h_k = |l_k + v|            Blinn (1977)
//     albedo^gamma = (base^gamma - seen H) / seen S,  shown = (albedo^gamma S + H)^(1 / gamma)
//
// View space. LIT 1: gamma is 1. Lamps that are not there have strength and share 0; room for LAMPS of avatar/light.py.
uniform vec4 lamps[4];  // towards the lamp, unit; its strength
uniform vec4 shares;    // of the highlight
uniform vec3 ambience;  // ambient, gloss, exponent
uniform vec3 gains;     // of display values, at last
#if LIT == 2
uniform float gamma;
#endif

vec3 lit(vec3 base, vec2 seen, vec3 n, vec3 v) {
    float shading = ambience.x, highlight = 0.0;
    for (int k = 0; k < 4; k++) {
        shading += lamps[k].w * max(dot(n, lamps[k].xyz), 0.0);
        vec3 h = lamps[k].xyz + v;
        // an eye straight behind the lamp has no half direction; pow(0, y) is undefined in GLSL
        float lobe = max(dot(n, h) * inversesqrt(max(dot(h, h), 1e-12)), 1e-4);
        highlight += shares[k] * pow(lobe, ambience.z);
    }
    highlight *= ambience.y;
#if LIT == 2
    base = pow(max(base, 1e-4), vec3(gamma));
#endif
    vec3 shown = max(base - seen.y, 0.0) / seen.x * shading + highlight;
#if LIT == 2
    shown = pow(clamp(shown, 1e-6, 1.0), vec3(1.0 / gamma));
#endif
    return clamp(shown * gains, 0.0, 1.0);
}
