// State of a texel's refinement: its material, packed like the estimates, and its status, one texel of u_status.

#include "common/estimate.glsl"
#include "fitness/unfit.glsl"

// A texel has converged after this many iterations without a change.
#define CONVERGED_AFTER 2.0

struct Status {
    float fitness;
    float damping;      // λ
    float stalled;      // consecutive iterations without a change
    float evaluations;  // so far
};

Status status_from(vec4 stored)
{
    Status status;
    status.fitness = stored.x;
    status.damping = stored.y;
    status.stalled = stored.z;
    status.evaluations = stored.w;
    return status;
}

vec4 stored_status(Status status)
{
    return vec4(status.fitness, status.damping, status.stalled, status.evaluations);
}

Status fresh_status(float evaluations)
{
    return status_from(vec4(UNFIT, DAMPING, 0.0, evaluations));
}

// Returns the status of the material that is kept, with the evaluations of both.
Status kept_status(Status before, Status after, bool better)
{
    Status kept = status_from(better ? stored_status(after) : stored_status(before));
    kept.evaluations = max(before.evaluations, after.evaluations);
    return kept;
}

void write_material(Material s)
{
    float c[MAX_COMPONENTS];
    material_to(s, c);
    write_estimate(c);
}
