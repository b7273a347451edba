// Over W × rows: the value at every particle's position, by FUNCTION (functions.py), and the particle's least so far.
// Reads u_x and, without START, u_least; writes o_value, o_least.

#include "layout.glsl"

#define SCHWEFEL_VALUE 418.98288727243369
#define TWO_PI 6.28318530717958648
#define E 2.71828182845904524

float value_at(int particle)
{
    float total = 0.0;
    float product = 1.0;
    float before = 0.0;
    for (int block = 0; block < BLOCKS; block++) {
        vec4 four = u_reach * (2.0 * texelFetch(u_x, place_of_block(particle, block, u_width), 0) - 1.0);
        for (int k = 0; k < 4; k++) {
            int d = 4 * block + k;
            if (d >= DIMENSIONS) {
                break;
            }
            float y = four[k];
#if FUNCTION == 0
            total += y * y;
#elif FUNCTION == 1
            if (d > 0) {
                float bend = y - before * before;
                total += 100.0 * bend * bend + (1.0 - before) * (1.0 - before);
            }
            before = y;
#elif FUNCTION == 2
            total += y * y - 10.0 * cos(TWO_PI * y) + 10.0;
#elif FUNCTION == 3
            total += y * y;
            product *= cos(y * inversesqrt(float(d + 1)));
#elif FUNCTION == 4
            total += y * y;
            before += cos(TWO_PI * y);
#else
            total += SCHWEFEL_VALUE - y * sin(sqrt(abs(y)));
#endif
        }
    }
#if FUNCTION == 3
    return total / 4000.0 - product + 1.0;
#elif FUNCTION == 4
    return -20.0 * exp(-0.2 * sqrt(total / float(DIMENSIONS))) - exp(before / float(DIMENSIONS)) + 20.0 + E;
#else
    return total;
#endif
}

bool texel_kernel(ivec2 texel)
{
    int particle = particle_of(texel, u_width);
    float value = particle < PARTICLES ? value_at(particle) : 1e30;
    o_value = value;
#ifdef START
    o_least = value;
#else
    o_least = min(value, texelFetch(u_least, texel, 0).x);
#endif
    return true;
}
