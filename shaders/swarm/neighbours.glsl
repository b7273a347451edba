// A of Eq. 4 of the paper: the mean of the global bests in an H×H window around a texel, in encoded coordinates.
// Neighbours that are not covered do not count. On a mesh the normal of a neighbour is rotated from the neighbour's
// tangent frame into this texel's. Reads u_best and the packing.

#include "common/frame.glsl"
#include "common/packing.glsl"
#include "swarm/encoding.glsl"

void rotate_normal(Frame from, Frame to, inout float best[MAX_DIMENSIONS])
{
#if NORMAL_SIZE == 2
    vec3 n = normal_from_hemisphere(vec2(best[NORMAL_AT], best[NORMAL_AT + 1]));
    vec2 turned = hemisphere_from_normal(to_local(to, to_world(from, n)));
    best[NORMAL_AT] = turned.x;
    best[NORMAL_AT + 1] = turned.y;
#elif NORMAL_SIZE == 3
    // The vector keeps its length, which is part of the particle's position.
    vec3 n = 2.0 * vec3(best[NORMAL_AT], best[NORMAL_AT + 1], best[NORMAL_AT + 2]) - 1.0;
    n.z = abs(n.z);
    n = 0.5 * to_local(to, to_world(from, n)) + 0.5;
    best[NORMAL_AT] = n.x;
    best[NORMAL_AT + 1] = n.y;
    best[NORMAL_AT + 2] = n.z;
#endif
}

// Reads the global best of the packed texel ``other`` in the frame f of ``texel``.
void read_neighbour(ivec2 other, ivec2 texel, Frame f, out float best[MAX_DIMENSIONS])
{
    read_best(other, best);
#if NORMAL_SIZE > 0 && !defined(CARD)
    if (other != texel) {
        rotate_normal(frame_at(other), f, best);
    }
#endif
}

void neighbourhood_mean(ivec2 texel, Frame f, out float mean[MAX_DIMENSIONS])
{
    for (int i = 0; i < MAX_DIMENSIONS; i++) {
        mean[i] = 0.0;
    }
    float count = 0.0;
    ivec4 place_on_surface = surface_place_of(texel);
    for (int y = -WINDOW_RADIUS; y <= WINDOW_RADIUS; y++) {
        for (int x = -WINDOW_RADIUS; x <= WINDOW_RADIUS; x++) {
            ivec2 other = neighbour_at(place_on_surface, ivec2(x, y));
            if (other.x < 0) {
                continue;
            }
            float best[MAX_DIMENSIONS];
            read_neighbour(other, texel, f, best);
            for (int i = 0; i < DIMENSIONS; i++) {
                mean[i] += best[i];
            }
            count += 1.0;
        }
    }
    for (int i = 0; i < DIMENSIONS; i++) {
        mean[i] /= count;
    }
}
