// Over W×H texels: estimates the indirect light of a matt texel from its shadows. Indirect light from matt surfaces
// changes slowly with the lamp's direction: spherical harmonics to order 2 (Basri and Jacobs 2003). A texel in attached
// or cast shadow shows indirect light alone. The pass fits harmonics to the samples in shadow; they predict the lit
// samples' indirect light. Reads the estimates' normals and u_misfit, the prefit's loss, at most 1 (0: skip the texel).
// Writes nine coefficients (mean over the channels of radiance over irradiance/π), red and green of the chroma, and the
// indirect share of the texel's light; zeros where a test fails.

#include "common/estimate.glsl"
#include "common/observation.glsl"

#define HARMONICS 9
#define MIN_LIGHT 1e-30

#define FACING 0.2       // least cosine to the lamp of a lit sample and of a cast shadow
#define DARK 0.15        // most direct light in a cast shadow, over the unshadowed direct light
#define LIT 0.8          // percentile of the samples' albedos that is the texel's: most lamps may be occluded
#define BRIGHT 0.95      // percentile of the light
#define ROUNDS 3         // of normal, shadows and harmonics
#define FITS 4           // reweighted least squares of a fit
#define SMALL 0.02       // scale of the errors, over the texel's bright light
#define RIDGE_MEAN 0.001 // of the harmonic of order 0
#define RIDGE 0.1        // of the other harmonics
#define RIDGE_DIRECT 1e-4 // of a Lambertian normal, over the trace of its normal equations

// Acceptance tests. On convex subjects the dark samples show noise and sheen, which harmonics do not explain. The
// extrapolated harmonics turn the normal by about 1° on their own: a turn below the chord MIN_TURN is not accepted.
// Metal is dark beside its highlight, like a matt texel with cast shadows; but the prefit explains it better. Where the
// Lambertian fit did not have to be better than the prefit, normals of brass without bounces were off by 6.7 in place
// of 2.7° in the mean, by 38 in place of 3° at the accepted texels.
#define MIN_SHADOWED 10            // samples in shadow
#define MIN_LIT 4         // lit samples
#define MAX_UNEXPLAINED 0.3 // of the light in shadow
#define MAX_GLOSS 0.25      // of the lit samples' direct light times u_misfit: its difference to a Lambertian texel's
#define MATT 0.02            // or of the lit samples' direct light: what no prefit explains much better

struct Indirect {
    float c[HARMONICS];
};

Indirect no_indirect()
{
    Indirect none;
    for (int i = 0; i < HARMONICS; i++) {
        none.c[i] = 0.0;
    }
    return none;
}

void harmonics(vec3 l, out float b[HARMONICS])
{
    b[0] = 1.0;
    b[1] = l.x;
    b[2] = l.y;
    b[3] = l.z;
    b[4] = l.x * l.y;
    b[5] = l.x * l.z;
    b[6] = l.y * l.z;
    b[7] = l.x * l.x - l.y * l.y;
    b[8] = 3.0 * l.z * l.z - 1.0;
}

float indirect_light(Indirect light, vec3 l)
{
    float b[HARMONICS];
    harmonics(l, b);
    float sum = 0.0;
    for (int i = 0; i < HARMONICS; i++) {
        sum += light.c[i] * b[i];
    }
    return max(sum, 0.0);
}

// A sample: direction to its lamp, light over irradiance/π, its mean over the channels, and the cosine of the lamp.
struct Sample {
    vec3 l;
    vec3 light;
    float grey;
    float cosine;
};

// Returns false for bounds and for samples without a weight.
bool read_sample(Texel t, int k, vec3 n, out Sample s)
{
    Observation o;
    bool counted = observe(t, k, o) && o.clipped.r + o.clipped.g + o.clipped.b == 0.0;
    s.l = o.l;
    s.light = counted ? max(o.radiance, vec3(0.0)) / o.intensity : vec3(0.0);
    s.grey = (s.light.r + s.light.g + s.light.b) / 3.0;
    s.cosine = dot(o.l, n);
    return counted;
}

// Kinds of quantities of which there are percentiles.
#define GREY_LIGHT 0
#define OWN_ALBEDO 1
#define LIT_ALBEDO 2

float direct_light(Sample s, Indirect indirect)
{
    return s.grey - min(indirect_light(indirect, s.l), s.grey);
}

bool cast_shadow(Sample s, Indirect indirect, float albedo)
{
    return s.cosine > FACING && direct_light(s, indirect) < DARK * albedo * s.cosine;
}

// Returns a quantity of sample k; −1 if sample k does not count. LIT_ALBEDO skips the cast shadows by ``before`` and
// ``albedo``.
float quantity(int kind, Texel t, int k, vec3 n, Indirect indirect, Indirect before, float albedo)
{
    Sample s;
    if (!read_sample(t, k, n, s)) {
        return -1.0;
    }
    if (kind == GREY_LIGHT) {
        return s.grey;
    }
    if (s.cosine <= FACING || (kind == LIT_ALBEDO && cast_shadow(s, before, albedo))) {
        return -1.0;
    }
    return direct_light(s, indirect) / s.cosine;
}

#define PARTS 16  // of an interval, between which a pass over the samples decides
#define PASSES 5  // 20 halvings

// Returns the percentile ``part`` (0 to 1) of a quantity over the samples; 0 without any. Without sorting: each pass
// counts the samples up to the bounds of PARTS parts of an interval, and goes on with the part of the percentile.
float percentile(int kind, float part, Texel t, vec3 n, Indirect indirect, Indirect before, float albedo)
{
    float high = 0.0;
    int count = 0;
    int zeros = 0;
    for (int k = 0; k < u_observations; k++) {
        float value = quantity(kind, t, k, n, indirect, before, albedo);
        count += value >= 0.0 ? 1 : 0;
        zeros += value == 0.0 ? 1 : 0;
        high = max(high, value);
    }
    float rank = part * float(max(count - 1, 0));
    float bounds[PARTS + 1];
    bounds[0] = 0.0;
    bounds[PARTS] = float(zeros) > rank ? 0.0 : high;
    for (int i = 0; i < PASSES && bounds[PARTS] > 0.0; i++) {
        for (int width = PARTS; width > 1; width /= 2) {
            for (int j = 0; j < PARTS; j += width) {
                bounds[j + width / 2] = 0.5 * (bounds[j] + bounds[j + width]);
            }
        }
        int below[PARTS];
        for (int j = 1; j < PARTS; j++) {
            below[j] = 0;
        }
        for (int k = 0; k < u_observations; k++) {
            float value = quantity(kind, t, k, n, indirect, before, albedo);
            for (int j = 1; j < PARTS; j++) {
                below[j] += value >= 0.0 && value <= bounds[j] ? 1 : 0;
            }
        }
        int chosen = 1;
        for (int j = 1; j < PARTS; j++) {
            chosen += float(below[j]) > rank ? 0 : 1;
        }
        bounds[0] = bounds[chosen - 1];
        bounds[PARTS] = bounds[chosen];
    }
    // The values around the upper bound are those of the whole ranks around the percentile's.
    float least = 0.0;
    float next = -1.0;
    for (int k = 0; k < u_observations; k++) {
        float value = quantity(kind, t, k, n, indirect, before, albedo);
        if (value > bounds[PARTS]) {
            next = next < 0.0 ? value : min(next, value);
        } else {
            least = max(least, value);
        }
    }
    return next < 0.0 ? least : mix(least, next, fract(rank));
}

// Returns the number of samples in attached or cast shadow.
int count_shadows(Texel t, vec3 n, Indirect indirect, float albedo)
{
    int count = 0;
    for (int k = 0; k < u_observations; k++) {
        Sample s;
        count += read_sample(t, k, n, s) && (s.cosine < 0.0 || cast_shadow(s, indirect, albedo)) ? 1 : 0;
    }
    return count;
}

#define TRIANGLE (HARMONICS * (HARMONICS + 1) / 2)

// Replaces x by A⁻¹ x. a: lower triangle of the positive definite A, row by row. Cholesky: A = L Lᵀ.
void solve(inout float a[TRIANGLE], inout float x[HARMONICS])
{
    for (int j = 0; j < HARMONICS; j++) {
        int row = j * (j + 1) / 2;
        float d = a[row + j];
        for (int k = 0; k < j; k++) {
            d -= a[row + k] * a[row + k];
        }
        d = sqrt(max(d, 1e-12));
        a[row + j] = d;
        for (int i = j + 1; i < HARMONICS; i++) {
            int other = i * (i + 1) / 2;
            float sum = a[other + j];
            for (int k = 0; k < j; k++) {
                sum -= a[other + k] * a[row + k];
            }
            a[other + j] = sum / d;
        }
        float sum = x[j];
        for (int k = 0; k < j; k++) {
            sum -= a[row + k] * x[k];
        }
        x[j] = sum / d;
    }
    for (int j = HARMONICS - 1; j >= 0; j--) {
        float sum = x[j];
        for (int i = j + 1; i < HARMONICS; i++) {
            sum -= a[i * (i + 1) / 2 + j] * x[i];
        }
        x[j] = sum / a[j * (j + 1) / 2 + j];
    }
}

// Returns the weight of a sample with this error: iteratively reweighted least absolute errors.
float weight_of(float error, float bright)
{
    return SMALL / (abs(error) / bright + SMALL);
}

// Fits harmonics to the samples in shadow. previous: decides with ``albedo`` which samples lie in a cast shadow.
Indirect fit_indirect(Texel t, vec3 n, Indirect previous, float albedo, float bright)
{
    Indirect fit = previous;
    for (int round = 0; round < FITS; round++) {
        float gram[TRIANGLE];
        float right[HARMONICS];
        float b[HARMONICS];
        for (int i = 0; i < TRIANGLE; i++) {
            gram[i] = 0.0;
        }
        for (int i = 0; i < HARMONICS; i++) {
            right[i] = 0.0;
            gram[i * (i + 1) / 2 + i] = i == 0 ? RIDGE_MEAN : RIDGE;
        }
        for (int k = 0; k < u_observations; k++) {
            Sample s;
            if (read_sample(t, k, n, s) && (s.cosine < 0.0 || cast_shadow(s, previous, albedo))) {
                float weight = round == 0 ? 1.0 : weight_of(s.grey - indirect_light(fit, s.l), bright);
                harmonics(s.l, b);
                for (int i = 0; i < HARMONICS; i++) {
                    right[i] += weight * b[i] * s.grey;
                    for (int j = 0; j <= i; j++) {
                        gram[i * (i + 1) / 2 + j] += weight * b[i] * b[j];
                    }
                }
            }
        }
        solve(gram, right);
        for (int i = 0; i < HARMONICS; i++) {
            fit.c[i] = right[i];
        }
    }
    return fit;
}

// The fit of a texel. The normal n, ``before`` and the albedo decide which samples lie in shadow; ``indirect`` fits
// these.
struct Fit {
    vec3 n;
    Indirect before;
    float albedo;
    Indirect indirect;
    float bright;
};

bool is_lit(Sample s, Fit fit)
{
    return s.cosine > FACING && !cast_shadow(s, fit.before, fit.albedo);
}

// Fits a Lambertian texel to the lit samples without this indirect light. Returns its normal; fit.n if they are too few
// or the normal faces away.
vec3 lambertian_normal(Texel t, Fit fit, Indirect indirect)
{
    vec3 scaled = vec3(0.0); // albedo times normal
    for (int round = 0; round < FITS; round++) {
        mat3 gram = mat3(0.0);
        vec3 right = vec3(0.0);
        int lit = 0;
        for (int k = 0; k < u_observations; k++) {
            Sample s;
            if (read_sample(t, k, fit.n, s) && is_lit(s, fit)) {
                float direct = direct_light(s, indirect);
                float weight = round == 0 ? 1.0 : weight_of(direct - dot(scaled, s.l), fit.bright);
                gram += weight * mat3(s.l * s.l.x, s.l * s.l.y, s.l * s.l.z);
                right += weight * direct * s.l;
                lit++;
            }
        }
        if (lit < MIN_LIT) {
            return fit.n;
        }
        scaled = inverse(gram + mat3(RIDGE_DIRECT * (gram[0][0] + gram[1][1] + gram[2][2]))) * right;
    }
    return scaled.z > 0.0 ? normalize(scaled) : fit.n;
}

// Returns false where too few samples lie in shadow. n: first normal; indirect light may have turned it.
bool fit_texel(Texel t, vec3 n, out Fit fit)
{
    fit.indirect = no_indirect();
    fit.before = fit.indirect;
    fit.n = n;
    fit.albedo = 0.0;
    fit.bright = MIN_LIGHT;
    // An early exit for most texels: too few shadows even by the highest albedo of a sample.
    float most = 0.0;
    for (int k = 0; k < u_observations; k++) {
        most = max(most, quantity(OWN_ALBEDO, t, k, n, fit.indirect, fit.indirect, 0.0));
    }
    if (count_shadows(t, n, fit.indirect, most) < MIN_SHADOWED) {
        return false;
    }
    fit.bright = max(percentile(GREY_LIGHT, BRIGHT, t, n, fit.indirect, fit.indirect, 0.0), MIN_LIGHT);
    for (int round = 0; round < ROUNDS; round++) {
        if (round > 0) {
            fit.n = lambertian_normal(t, fit, fit.indirect);
        }
        fit.before = fit.indirect;
        fit.albedo = percentile(OWN_ALBEDO, LIT, t, fit.n, fit.indirect, fit.indirect, 0.0);
        if (count_shadows(t, fit.n, fit.indirect, fit.albedo) < MIN_SHADOWED) {
            return false;
        }
        fit.indirect = fit_indirect(t, fit.n, fit.indirect, fit.albedo, fit.bright);
    }
    return true;
}

// Returns red and green of the chroma of the indirect light, and its share; 0 where an acceptance test fails.
vec3 accepted_chroma_and_share(Texel t, Fit fit, float misfit)
{
    float dark = 0.0;
    float unexplained = 0.0;
    vec2 light = vec2(0.0);
    vec3 colour = vec3(0.0);
    float lit = 0.0;
    for (int k = 0; k < u_observations; k++) {
        Sample s;
        if (read_sample(t, k, fit.n, s)) {
            float direct = direct_light(s, fit.indirect);
            bool shade = cast_shadow(s, fit.before, fit.albedo);
            light += vec2(s.grey - direct, s.grey);
            if (s.cosine < 0.0 || shade) {
                dark += s.grey;
                unexplained += abs(direct);
                colour += weight_of(s.grey - indirect_light(fit.indirect, s.l), fit.bright) * s.light;
            }
            lit += is_lit(s, fit) ? direct : 0.0;
        }
    }
    float share = light.x / max(light.y, MIN_LIGHT);
    if (!(unexplained < MAX_UNEXPLAINED * dark && share >= MIN_SHARE)) {
        return vec3(0.0);
    }
    float matt = percentile(LIT_ALBEDO, 0.5, t, fit.n, fit.indirect, fit.before, fit.albedo);
    float gloss = 0.0;
    for (int k = 0; k < u_observations; k++) {
        Sample s;
        if (read_sample(t, k, fit.n, s) && is_lit(s, fit)) {
            gloss += abs(direct_light(s, fit.indirect) - matt * s.cosine);
        }
    }
    if (!(gloss < max(MAX_GLOSS * misfit, MATT) * lit)) {
        return vec3(0.0);
    }
    vec3 turned = lambertian_normal(t, fit, fit.indirect) - lambertian_normal(t, fit, no_indirect());
    vec3 chroma = colour / max(colour.r + colour.g + colour.b, MIN_LIGHT);
    return length(turned) >= MIN_TURN ? vec3(chroma.rg, share) : vec3(0.0);
}

bool texel_kernel(ivec2 texel)
{
    o_low = vec4(0.0);
    o_middle = vec4(0.0);
    o_high = vec4(0.0);
    float misfit = texelFetch(u_misfit, texel, 0).x;
    if (state_at(texel) != TEXEL_SOLVED || misfit == 0.0) {
        return true;
    }
    Texel t = observed_texel(texel);
    t.shadow = 0.0;
    float c[MAX_COMPONENTS];
    read_estimate(texel, c);
    vec3 n = vec3(c[NORMAL_COMPONENT], c[NORMAL_COMPONENT + 1], c[NORMAL_COMPONENT + 2]);
    Fit fit;
    if (fit_texel(t, n, fit)) {
        vec3 found = accepted_chroma_and_share(t, fit, misfit);
        if (found.z > 0.0) {
            o_low = vec4(fit.indirect.c[0], fit.indirect.c[1], fit.indirect.c[2], fit.indirect.c[3]);
            o_middle = vec4(fit.indirect.c[4], fit.indirect.c[5], fit.indirect.c[6], fit.indirect.c[7]);
            o_high = vec4(fit.indirect.c[8], found);
        }
    }
    return true;
}
