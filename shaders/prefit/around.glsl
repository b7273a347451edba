// Sum of u_measured, the measures of the prefits, over a texel and its neighbours. Reads u_measured and the packing.

#include "common/frame.glsl"
#include "common/packing.glsl"
#include "common/taps.glsl"

vec4 neighbourhood_sum(ivec2 texel)
{
    vec4 sum = texelFetch(u_measured, texel, 0);
    ivec4 place = surface_place_of(texel);
    for (int t = 0; t < TAPS; t++) {
        ivec2 other = neighbour_at(place, tap_at(t));
        if (other.x >= 0) {
            sum += texelFetch(u_measured, other, 0);
        }
    }
    return sum;
}
