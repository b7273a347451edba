// Over W×H texels: what the refinement has made of a texel, unless its model explains the texel much worse than the prefit's
// does. Then the refinement has turned the normal to make up for what the model cannot tell, and the texel keeps what it had:
// the prefit's normal, and the rest fitted to it. Reads the estimates before the refinement, u_work_…: those after it, and
// u_prefit_fitness: the prefit's own. Fitnesses are compared on the prefit's terms, of grey samples.

#include "common/estimate.glsl"
#include "fitness/fitness.glsl"

bool texel_kernel(ivec2 texel)
{
    o_estimate_0 = texelFetch(u_work_0, texel, 0);
#if ESTIMATES > 1
    o_estimate_1 = texelFetch(u_work_1, texel, 0);
#endif
#if ESTIMATES > 2
    o_estimate_2 = texelFetch(u_work_2, texel, 0);
#endif
    if (state_at(texel) != TEXEL_SOLVED) {
        return true;
    }
    float c[12];
    vec4 part = o_estimate_0;
    for (int i = 0; i < 4; i++) {
        c[i] = part[i];
    }
#if ESTIMATES > 1
    part = o_estimate_1;
#endif
    for (int i = 0; i < 4; i++) {
        c[4 + i] = part[i];
    }
#if ESTIMATES > 2
    part = o_estimate_2;
#endif
    for (int i = 0; i < 4; i++) {
        c[8 + i] = part[i];
    }
    float weights;
    float fitness = fitness_of(texel, frame_at(texel), material_from(c), weights);
    if (fitness > ACCEPTANCE_RATIO * texelFetch(u_prefit_fitness, texel, 0).x + ACCEPTANCE_FLOOR) {
        o_estimate_0 = texelFetch(u_estimate_0, texel, 0);
#if ESTIMATES > 1
        o_estimate_1 = texelFetch(u_estimate_1, texel, 0);
#endif
#if ESTIMATES > 2
        o_estimate_2 = texelFetch(u_estimate_2, texel, 0);
#endif
    }
    return true;
}
