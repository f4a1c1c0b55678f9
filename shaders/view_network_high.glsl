// View dependence by the avatar's network of eight features, 12 -> 16 -> 16 -> 3:
//
//     x = [features, t', |t'|]    h = max(W1 x + b1, 0)    g = max(W2 h + b2, 0)    y = W3 g + b3
//     residual = A |t'| y / (1 + |y|)
//
// As view_network.glsl, with a second hidden layer; `more` are features 4 to 7.
#include "network_constants.glsl"

vec3 view_residual(vec4 features, vec4 more, vec3 tangent) {
    float far = length(tangent);
    vec4 x = vec4(tangent, far);
    vec4 h0 = max(W1_F0 * features + W1_G0 * more + W1_T0 * x + B1_0, 0.0);
    vec4 h1 = max(W1_F1 * features + W1_G1 * more + W1_T1 * x + B1_1, 0.0);
    vec4 h2 = max(W1_F2 * features + W1_G2 * more + W1_T2 * x + B1_2, 0.0);
    vec4 h3 = max(W1_F3 * features + W1_G3 * more + W1_T3 * x + B1_3, 0.0);
    vec4 g0 = max(W2_00 * h0 + W2_01 * h1 + W2_02 * h2 + W2_03 * h3 + B2_0, 0.0);
    vec4 g1 = max(W2_10 * h0 + W2_11 * h1 + W2_12 * h2 + W2_13 * h3 + B2_1, 0.0);
    vec4 g2 = max(W2_20 * h0 + W2_21 * h1 + W2_22 * h2 + W2_23 * h3 + B2_2, 0.0);
    vec4 g3 = max(W2_30 * h0 + W2_31 * h1 + W2_32 * h2 + W2_33 * h3 + B2_3, 0.0);
    vec3 y = WY_0 * g0 + WY_1 * g1 + WY_2 * g2 + WY_3 * g3 + BY;
    return AMPLITUDE * far * y / (1.0 + abs(y));
}
