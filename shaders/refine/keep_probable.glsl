// Over W×H texels: keeps the more probable of two materials, by the samples and their support (neighbour_support.glsl).
// Reads the best so far (u_estimate, u_status), the refined one (u_work, u_work_status), the weights of the samples and
// the packing.

#include "common/observation.glsl"
#include "refine/status.glsl"
#include "refine/neighbour_support.glsl"

bool texel_kernel(ivec2 texel)
{
    float own[MAX_COMPONENTS];
    float work[MAX_COMPONENTS];
    read_estimate(texel, own);
    read_work(texel, work);
    Status before = status_from(texelFetch(u_status, texel, 0));
    Status after = status_from(texelFetch(u_work_status, texel, 0));
    bool better = false;
    if (state_at(texel) == TEXEL_SOLVED) {
        float weights = 0.0;
        Texel t = observed_texel(texel);
        Observation o;
        EACH_OBSERVATION(t, o) {
            weights += o.weight;
        }
        float freedom = degrees_of_freedom(weights);
        better = after.fitness <= before.fitness;
        if (freedom > 0.0 && max(before.fitness, after.fitness) < UNFIT) {
            ivec4 place = surface_place_of(texel);
            better = deviance_of(freedom, after.fitness, neighbour_support_of(place, work)) <=
                     deviance_of(freedom, before.fitness, neighbour_support_of(place, own));
        }
    }
    if (better) {
        write_estimate(work);
    }
    else {
        write_estimate(own);
    }
    o_status = stored_status(kept_status(before, after, better));
    return true;
}
