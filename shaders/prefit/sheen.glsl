// Over W×H texels: where the prefit with sheen replaces the first one. There the first explains a texel and its neighbours
// badly, and the second by SHEEN_GAIN better. Reads u_fits (both fitnesses, 1 where both are measures) and the packing.
// Writes o_chosen: there 1, 0 elsewhere.

#include "common/frame.glsl"
#include "common/packing.glsl"
#include "common/taps.glsl"

bool texel_kernel(ivec2 texel)
{
    o_chosen = 0.0;
    vec4 sum = texelFetch(u_fits, texel, 0);
    if (state_at(texel) == TEXEL_SOLVED && sum.z > 0.0) {
        ivec4 place = surface_place_of(texel);
        for (int t = 0; t < TAPS; t++) {
            ivec2 other = neighbour_at(place, tap_at(t));
            if (other.x >= 0) {
                sum += texelFetch(u_fits, other, 0);
            }
        }
        if (sum.x > LEAST_FITNESS * sum.z && sum.y < (1.0 - SHEEN_GAIN) * sum.x) {
            o_chosen = 1.0;
        }
    }
    return true;
}
