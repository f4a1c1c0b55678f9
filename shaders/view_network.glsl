// View dependence by the avatar's network of four features, 8 -> 16 -> 3:
//
//     x = [features, t', |t'|]    h = max(W1 x + b1, 0)    y = W2 h + b2    residual = A |t'| y / (1 + |y|)
//
// At t' = 0 the residual is 0 whatever the weights, and it never exceeds A |t'|: softsign has no exponential to
// overflow. The weights are constants of one avatar, written by player/gl/constants.py: literals measured 3-6 times
// faster than uniforms on a software rasteriser.
#include "network_constants.glsl"

vec3 view_residual(vec4 features, vec3 tangent) {
    float far = length(tangent);
    vec4 x = vec4(tangent, far);
    vec4 h0 = max(W1_F0 * features + W1_T0 * x + B1_0, 0.0);
    vec4 h1 = max(W1_F1 * features + W1_T1 * x + B1_1, 0.0);
    vec4 h2 = max(W1_F2 * features + W1_T2 * x + B1_2, 0.0);
    vec4 h3 = max(W1_F3 * features + W1_T3 * x + B1_3, 0.0);
    vec3 y = WY_0 * h0 + WY_1 * h1 + WY_2 * h2 + WY_3 * h3 + BY;
    return AMPLITUDE * far * y / (1.0 + abs(y));
}
