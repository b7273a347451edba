// What prefits have measured of a texel and its neighbours: sums over u_measured. Reads u_measured and the packing.

#include "common/frame.glsl"
#include "common/packing.glsl"
#include "common/taps.glsl"

vec4 measured_around(ivec2 texel)
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
