// An avatar lit anew: the light that its base colour shows is taken out, another one put in. Mirrors avatar/light.py:
//
//     S(n) = ambient + sum_k strength_k max(n . l_k, 0)
//     H(n, v) = gloss sum_k share_k max(n . h_k, 0)^exponent,  h_k = |l_k + v|            Blinn (1977)
//     albedo^gamma = (base^gamma - seen H) / seen S,  shown = (albedo^gamma S + H)^(1 / gamma)
//
// View space, at each vertex: triangles of an avatar are a few pixels large, and in software a pixel of each costs more
// than its corners. lit.glsl has the rest. LIT 1: nothing gleams; 2: gamma is 1; 3: both. Lamps that are not there have
// strength and share 0; room for LAMPS of avatar/light.py.
uniform vec4 lamps[4];  // towards the lamp, unit; its strength
uniform vec3 ambience;  // ambient, gloss, exponent
#if LIT == 1
uniform float gamma;
#else
uniform vec4 shares;  // of the highlight
#endif

float shading(vec3 n) {
    float sum = ambience.x;
    for (int k = 0; k < 4; k++) {
        sum += lamps[k].w * max(dot(n, lamps[k].xyz), 0.0);
    }
    return sum;
}

#if LIT == 1
// shown / base
float light_factors(vec2 seen, vec3 n, vec3 v) {
    return pow(max(shading(n) / seen.x, 1e-6), 1.0 / gamma);
}
#else
// S / seen S, seen H, H
vec3 light_factors(vec2 seen, vec3 n, vec3 v) {
    float highlight = 0.0;
    for (int k = 0; k < 4; k++) {
        vec3 h = lamps[k].xyz + v;
        // an eye straight behind the lamp has no half direction; pow(0, y) is undefined in GLSL
        float lobe = max(dot(n, h) * inversesqrt(max(dot(h, h), 1e-12)), 1e-4);
        highlight += shares[k] * pow(lobe, ambience.z);
    }
    return vec3(shading(n) / seen.x, seen.y, highlight * ambience.y);
}
#endif
