// A shadow mask about a place, averaged over 2^mip texels. Of player/effects/shadow.py.
uniform sampler2D mask;  // cover; cover times (1 - height / tall)

// Four fetches half a texel of the mip off: no edge of a texel shows, at any mip between two.
// The finest is left sharper.
vec2 smoothed(vec2 at, float mip) {
    vec2 off = (0.5 * exp2(mip) - 0.25) / vec2(textureSize(mask, 0));
    return 0.25 * (textureLod(mask, at - off, mip).rg + textureLod(mask, at + off, mip).rg
                   + textureLod(mask, at + vec2(off.x, -off.y), mip).rg
                   + textureLod(mask, at + vec2(-off.x, off.y), mip).rg);
}
