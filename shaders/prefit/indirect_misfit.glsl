// Over W×H texels: misfit of the prefit over all samples, those in shadow included. Writes o_indirect_misfit: x sum of
// errors, y sum of errors where the sample is brighter, both as fractions of the light, at most 1; z 1 if MIN_SAMPLES
// samples reach RAISED_SHADOW times the texel's scale, else 0; w 1. Samples and fit are clamped to the scale (no
// highlights).

#include "common/estimate.glsl"
#include "common/observation.glsl"
#include "model.glsl"

bool texel_kernel(ivec2 texel)
{
    o_indirect_misfit = vec4(0.0);
    if (state_at(texel) == TEXEL_SOLVED) {
        Texel t = observed_texel(texel);
        Material s = estimate_at(texel);
        float light = 0.0;
        vec2 misfit = vec2(0.0);
        int bright = 0;
        Observation o;
        EACH_OBSERVATION(t, o) {
            float sample_light = min(o.radiance.r, t.radiance_scale);
            float error = min(reflectance(s, o.l, o.v).r, t.radiance_scale) - sample_light;
            light += sample_light;
            misfit += vec2(abs(error), max(-error, 0.0));
            bright += o.radiance.r >= RAISED_SHADOW * t.radiance_scale ? 1 : 0;
        }
        o_indirect_misfit.x = misfit.x < light ? misfit.x / light : 1.0;
        o_indirect_misfit.y = misfit.y < light ? misfit.y / light : 1.0;
        o_indirect_misfit.z = bright >= MIN_SAMPLES ? 1.0 : 0.0;
        o_indirect_misfit.w = 1.0;
    }
    return true;
}
