// Over W×H texels: where the light is indirect. There the prefit explains the samples of the texel and its neighbours badly,
// and they are brighter than it: other surfaces add light. Reads u_evidence (evidence.glsl) and the packing. Writes o_shadow: there
// RAISED_SHADOW, 0 elsewhere.

#include "common/frame.glsl"
#include "common/packing.glsl"
#include "common/taps.glsl"

bool texel_kernel(ivec2 texel)
{
    o_shadow = 0.0;
    vec4 sum = texelFetch(u_evidence, texel, 0);
    if (state_at(texel) == TEXEL_SOLVED && sum.z > 0.0) {
        ivec4 place = surface_place_of(texel);
        for (int t = 0; t < TAPS; t++) {
            ivec2 other = neighbour_at(place, tap_at(t));
            if (other.x >= 0) {
                sum += texelFetch(u_evidence, other, 0);
            }
        }
        if (sum.x > LEAST_MISFIT * sum.w && sum.y > LEAST_SURPLUS * sum.w) {
            o_shadow = RAISED_SHADOW;
        }
    }
    return true;
}
