// Over W×H texels: what the refinement has made of a texel, unless its model explains the texel much worse than the prefit's
// does. Then the refinement has turned the normal to make up for what the model cannot tell, and the texel keeps what it had:
// the prefit's normal, and the rest fitted to it. Reads the estimates before the refinement, u_work: those after it, and
// u_prefit_fitness: the prefit's own. Fitnesses are compared on the prefit's terms, of grey samples.

#include "common/estimate.glsl"
#include "fitness/fitness.glsl"

bool texel_kernel(ivec2 texel)
{
    float c[12];
    read_work(texel, c);
    if (state_at(texel) == TEXEL_SOLVED) {
        float weights;
        float fitness = fitness_of(observed_texel(texel), material_from(c), weights);
        if (fitness > ACCEPTANCE_RATIO * texelFetch(u_prefit_fitness, texel, 0).x + ACCEPTANCE_FLOOR) {
            read_estimate(texel, c);
        }
    }
    write_estimate(c);
    return true;
}
