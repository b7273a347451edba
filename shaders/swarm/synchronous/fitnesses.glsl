// The fitness of each particle of a generation. Reads u_fitness_0 to u_fitness_3, four particles each.

#include "fitness/unfit.glsl"

float fitness_at(ivec2 texel, int particle)
{
    vec4 four = texelFetch(u_fitness_0, texel, 0);
#if PARTICLES > 4
    four = particle >= 4 ? texelFetch(u_fitness_1, texel, 0) : four;
#endif
#if PARTICLES > 8
    four = particle >= 8 ? texelFetch(u_fitness_2, texel, 0) : four;
#endif
#if PARTICLES > 12
    four = particle >= 12 ? texelFetch(u_fitness_3, texel, 0) : four;
#endif
    return four[particle % 4];
}
