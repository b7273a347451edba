// A step of the reduction tree: the least of SIDE × SIDE texels of u_from, and the first particle with it, to o_least.
// With FIRST u_from has one value a particle; else a value and a particle.

#include "layout.glsl"

bool texel_kernel(ivec2 texel)
{
    vec2 least = vec2(1e30, 0.0);
    ivec2 size = textureSize(u_from, 0);
    for (int y = 0; y < SIDE; y++) {
        for (int x = 0; x < SIDE; x++) {
            ivec2 at = texel * SIDE + ivec2(x, y);
            if (any(greaterThanEqual(at, size))) {
                continue;
            }
#ifdef FIRST
            vec2 found = vec2(texelFetch(u_from, at, 0).x, float(particle_of(at, u_width)));
#else
            vec2 found = texelFetch(u_from, at, 0).xy;
#endif
            if (found.x < least.x || (found.x == least.x && found.y < least.y)) {
                least = found;
            }
        }
    }
    o_least = vec4(least, 0.0, 0.0);
    return true;
}
