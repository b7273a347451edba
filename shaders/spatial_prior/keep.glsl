// Over W×H texels: accepts the fit with the prior (u_work, u_work_status) if its objective, penalty included, is lower
// than the estimate's, and its deviance without the penalty is at most TOLERANCE² higher. Else the estimate stays.
// Reads u_noise (x: loss of the estimate), u_penalty (its penalty), the geometry and the sample stack.

#include "common/estimate.glsl"
#include "fitness/fitness.glsl"
#include "fitness/lobes.glsl"
#include "refine/status.glsl"
#include "spatial_prior/loss_unit.glsl"

bool texel_kernel(ivec2 texel)
{
    Material result = estimate_at(texel);
    float objective = status_from(texelFetch(u_work_status, texel, 0)).fitness;
    if (state_at(texel) == TEXEL_SOLVED && objective < UNFIT) {
        vec4 noise = texelFetch(u_noise, texel, 0);
        float unit = loss_unit(texel);
        float c[MAX_COMPONENTS];
        read_work(texel, c);
        order_lobes(c);
        Material work = material_from(c);
        float weights;
        float fitness = fitness_of(observed_texel(texel), work, weights);
        float loss = 3.0 * weights * fitness;
        float estimate_objective = (noise.x * unit + texelFetch(u_penalty, texel, 0).x) / (3.0 * weights);
        bool better = objective < with_priors(estimate_objective, weights, result);
        if (better && loss <= (noise.x + TOLERANCE * TOLERANCE * deviance_unit(noise.w)) * unit) {
            result = work;
        }
    }
    write_material(result);
    return true;
}
