#include "common/observation.glsl"
#include "swarm/loss.glsl"

// What an error of a highlight counts, of one of the diffuse samples: a model is off in proportion to what it renders,
// so that δ grows with a sample that is brighter than the texel's scale. With the δ of the diffuse part a highlight is an
// outlier until it is met to a few percent, and the descent never comes there.
float relative_error(ivec2 texel, Observation o)
{
#if (FITNESS == FITNESS_ROBUST || FITNESS == FITNESS_BOUNDED)
    float level = scale_at(texel) * u_brightness;
    float brightest = max(o.radiance.r, max(o.radiance.g, o.radiance.b));
    return brightest > level ? pow(level / brightest, HIGHLIGHT_POWER) : 1.0;
#else
    return 1.0;
#endif
}
