// Eq. 4 of the paper: the mean of the global bests in an H×H window around a texel, in the coordinates of its search.
// Reads u_best and the packing. Uncovered neighbours do not count. On a mesh a neighbour's normal is first
// turned from its own tangent frame into this texel's.

#include "common/frame.glsl"
#include "common/packing.glsl"
#include "swarm/encoding.glsl"

void turn_normal(Frame from, Frame to, inout float g[8])
{
#if NORMAL_SIZE == 2
    vec3 n = normal_from_hemisphere(vec2(g[NORMAL_AT], g[NORMAL_AT + 1]));
    vec2 turned = hemisphere_from_normal(to_local(to, to_world(from, n)));
    g[NORMAL_AT] = turned.x;
    g[NORMAL_AT + 1] = turned.y;
#elif NORMAL_SIZE == 3
    // The vector keeps its length, which is part of the particle's place.
    vec3 n = 2.0 * vec3(g[NORMAL_AT], g[NORMAL_AT + 1], g[NORMAL_AT + 2]) - 1.0;
    n.z = abs(n.z);
    n = 0.5 * to_local(to, to_world(from, n)) + 0.5;
    g[NORMAL_AT] = n.x;
    g[NORMAL_AT + 1] = n.y;
    g[NORMAL_AT + 2] = n.z;
#endif
}

// Reads the global best of a packed texel, in this texel's frame.
void read_neighbour(ivec2 other, ivec2 texel, Frame f, out float g[8])
{
    read_best(other, g);
#if NORMAL_SIZE > 0 && !defined(CARD)
    if (other != texel) {
        turn_normal(frame_at(other), f, g);
    }
#endif
}

void neighbourhood_mean(ivec2 texel, Frame f, out float mean[8])
{
    for (int i = 0; i < 8; i++) {
        mean[i] = 0.0;
    }
    float count = 0.0;
    ivec4 place = surface_place_of(texel);
    for (int y = -REACH; y <= REACH; y++) {
        for (int x = -REACH; x <= REACH; x++) {
            ivec2 other = neighbour_at(place, ivec2(x, y));
            if (other.x < 0) {
                continue;
            }
            float g[8];
            read_neighbour(other, texel, f, g);
            for (int i = 0; i < DIMENSIONS; i++) {
                mean[i] += g[i];
            }
            count += 1.0;
        }
    }
    for (int i = 0; i < DIMENSIONS; i++) {
        mean[i] /= count;
    }
}
