// Over W×H texels: what the polish has made of a texel, unless its model explains the texel much worse than the survey's
// does. Then the polish has turned the normal to make up for what the model cannot tell, and the texel keeps what it had:
// the survey's normal, and the rest fitted to it. Reads the estimates before the polish, u_work_…: those after it, and
// u_survey_fitness: the survey's own. Fitnesses are compared on the survey's terms, of grey samples.

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
    if (fitness > TRUST * texelFetch(u_survey_fitness, texel, 0).x + TRUST_FLOOR) {
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
