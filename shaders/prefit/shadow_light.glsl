// Over W×H texels: the light that other surfaces send a matt texel, as its shadows tell it. Matt surfaces send light that
// changes slowly with the direction of the lamp: spherical harmonics to order 2 (Basri and Jacobs 2003). Photographs in
// which the texel lies in shadow, attached or cast, show that light alone; harmonics that are fitted to these tell it in the
// others. Reads the estimates, for their normal, and u_asked. Writes nine coefficients of the mean over the channels of
// radiance over irradiance/π, red and green of its chroma, and the part of the texel's light that it is; zeros where shadows
// do not tell it.

#include "common/estimate.glsl"
#include "common/observation.glsl"

#define HARMONICS 9
#define LEAST_LIGHT 1e-30

#define FACING 0.2       // cosine of a lamp from which on its light is sought, or missed where a cast shadow lies
#define DARK 0.15        // of the light that a texel would send without a cast shadow
#define LIT 0.8          // percentile of the albedos by single samples: most lamps may be hidden
#define BRIGHT 0.95      // percentile of the light
#define ROUNDS 3         // shadows by the normal and the light that is left, then both by them
#define FITS 4           // each weighted by the errors of the last
#define SMALL 0.02       // an error, as a part of a texel's bright light
#define RIDGE_MEAN 0.001 // of the mean light
#define RIDGE 0.1        // of the other coefficients
#define RIDGE_OWN 1e-6   // of the texel's own light

// What a texel must show: on convex subjects what is dark is noise and sheen, which no harmonics explain. The errors of the
// harmonics turn a normal by a degree: light that turns it by less than the chord LEAST_TURN stays.
#define FEWEST 10            // shadows
#define MOST_UNEXPLAINED 0.3 // of the light in them
#define MOST_GLOSS 0.25      // of the light beside them, unlike a matt surface's: metal is dark beside its highlight, too

struct Light {
    float c[HARMONICS];
};

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

float light_under(Light light, vec3 l)
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
struct Shown {
    vec3 l;
    vec3 light;
    float grey;
    float cosine;
};

// Returns false for bounds and for samples without a weight.
bool show(Texel t, int k, vec3 n, out Shown s)
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

// What is left of a sample's light without ``sent``.
float left_of(Shown s, Light sent)
{
    return s.grey - min(light_under(sent, s.l), s.grey);
}

bool cast_shadow(Shown s, Light sent, float albedo)
{
    return s.cosine > FACING && left_of(s, sent) < DARK * albedo * s.cosine;
}

// Returns a quantity of sample k, −1 if it does not count. sent: light of other surfaces; of LIT_ALBEDO, ``before`` and
// ``albedo`` say which samples lie in a cast shadow.
float quantity(int kind, Texel t, int k, vec3 n, Light sent, Light before, float albedo)
{
    Shown s;
    if (!show(t, k, n, s)) {
        return -1.0;
    }
    if (kind == GREY_LIGHT) {
        return s.grey;
    }
    if (s.cosine <= FACING || (kind == LIT_ALBEDO && cast_shadow(s, before, albedo))) {
        return -1.0;
    }
    return left_of(s, sent) / s.cosine;
}

#define HALVINGS 20

// Returns a percentile, as a part of 1, of a quantity over the samples; 0 without any. By halving: nothing is sorted.
float percentile(int kind, float part, Texel t, vec3 n, Light sent, Light before, float albedo)
{
    float low = -1.0;
    float high = 0.0;
    int count = 0;
    for (int k = 0; k < u_observations; k++) {
        float value = quantity(kind, t, k, n, sent, before, albedo);
        count += value >= 0.0 ? 1 : 0;
        high = max(high, value);
    }
    float rank = part * float(max(count - 1, 0));
    for (int i = 0; i < HALVINGS; i++) {
        float middle = i == 0 ? 0.0 : 0.5 * (low + high);
        int below = 0;
        for (int k = 0; k < u_observations; k++) {
            float value = quantity(kind, t, k, n, sent, before, albedo);
            below += value >= 0.0 && value <= middle ? 1 : 0;
        }
        if (float(below) > rank) {
            high = middle;
        } else {
            low = middle;
        }
    }
    // Between low and high lies the value of the whole rank below; the percentile lies between it and the next.
    float least = 0.0;
    float next = -1.0;
    for (int k = 0; k < u_observations; k++) {
        float value = quantity(kind, t, k, n, sent, before, albedo);
        if (value > high) {
            next = next < 0.0 ? value : min(next, value);
        } else {
            least = max(least, value);
        }
    }
    return next < 0.0 ? least : mix(least, next, fract(rank));
}

// How many samples lie in shadow, attached or cast.
int shadows(Texel t, vec3 n, Light sent, float albedo)
{
    int count = 0;
    for (int k = 0; k < u_observations; k++) {
        Shown s;
        count += show(t, k, n, s) && (s.cosine < 0.0 || cast_shadow(s, sent, albedo)) ? 1 : 0;
    }
    return count;
}

#define TRIANGLE (HARMONICS * (HARMONICS + 1) / 2)

// Solves A x = x for a positive definite A, given by its lower triangle, row by row. Cholesky: A = L Lᵀ.
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

// The weight of a sample by how far a fit is off it.
float weight_of(float error, float bright)
{
    return SMALL / (abs(error) / bright + SMALL);
}

// Returns the light in the shadows by least absolute errors: each fit is weighted by the errors of the last.
Light fitted(Texel t, vec3 n, Light sent, float albedo, float bright)
{
    Light fit = sent;
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
            Shown s;
            if (show(t, k, n, s) && (s.cosine < 0.0 || cast_shadow(s, sent, albedo))) {
                float weight = round == 0 ? 1.0 : weight_of(s.grey - light_under(fit, s.l), bright);
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

// The light of a texel by its shadows. n, before, albedo: by which samples lie in shadow. sent: what was fitted to these.
struct Told {
    vec3 n;
    Light before;
    float albedo;
    Light sent;
    float bright;
};

bool beside_shadows(Shown s, Told told)
{
    return s.cosine > FACING && !cast_shadow(s, told.before, told.albedo);
}

// Returns the normal of a Lambertian texel beside the shadows, by least absolute errors of what is left without ``sent``.
vec3 normal_without(Texel t, Told told, Light sent)
{
    vec3 own = vec3(0.0);
    for (int round = 0; round < FITS; round++) {
        mat3 gram = mat3(RIDGE_OWN);
        vec3 right = vec3(0.0);
        for (int k = 0; k < u_observations; k++) {
            Shown s;
            if (show(t, k, told.n, s) && beside_shadows(s, told)) {
                float left = left_of(s, sent);
                float weight = round == 0 ? 1.0 : weight_of(left - dot(own, s.l), told.bright);
                gram += weight * outerProduct(s.l, s.l);
                right += weight * left * s.l;
            }
        }
        own = inverse(gram) * right;
    }
    return own.z > 0.0 ? normalize(own) : told.n;
}

// Returns false where the shadows are too few. n: a first normal, which the light of other surfaces may have turned.
bool tell(Texel t, vec3 n, out Told told)
{
    for (int i = 0; i < HARMONICS; i++) {
        told.sent.c[i] = 0.0;
    }
    told.before = told.sent;
    told.n = n;
    told.albedo = 0.0;
    told.bright = LEAST_LIGHT;
    // Most texels have too few shadows even if the brightest sample says how much light they send.
    float most = 0.0;
    for (int k = 0; k < u_observations; k++) {
        most = max(most, quantity(OWN_ALBEDO, t, k, n, told.sent, told.sent, 0.0));
    }
    if (shadows(t, n, told.sent, most) < FEWEST) {
        return false;
    }
    told.bright = max(percentile(GREY_LIGHT, BRIGHT, t, n, told.sent, told.sent, 0.0), LEAST_LIGHT);
    for (int round = 0; round < ROUNDS; round++) {
        if (round > 0) {
            told.n = normal_without(t, told, told.sent);
        }
        told.before = told.sent;
        told.albedo = percentile(OWN_ALBEDO, LIT, t, told.n, told.sent, told.sent, 0.0);
        if (shadows(t, told.n, told.sent, told.albedo) < FEWEST) {
            return false;
        }
        told.sent = fitted(t, told.n, told.sent, told.albedo, told.bright);
    }
    return true;
}

// Returns red and green of the chroma of the light, and its share; 0 where it does not explain what the texel shows.
vec3 chroma_and_share(Texel t, Told told)
{
    float dark = 0.0;
    float unexplained = 0.0;
    vec2 light = vec2(0.0);
    vec3 colour = vec3(0.0);
    float lit = 0.0;
    for (int k = 0; k < u_observations; k++) {
        Shown s;
        if (show(t, k, told.n, s)) {
            float left = left_of(s, told.sent);
            bool shade = cast_shadow(s, told.before, told.albedo);
            light += vec2(s.grey - left, s.grey);
            if (s.cosine < 0.0 || shade) {
                dark += s.grey;
                unexplained += abs(left);
                colour += weight_of(s.grey - light_under(told.sent, s.l), told.bright) * s.light;
            }
            lit += beside_shadows(s, told) ? left : 0.0;
        }
    }
    float matt = percentile(LIT_ALBEDO, 0.5, t, told.n, told.sent, told.before, told.albedo);
    float gloss = 0.0;
    for (int k = 0; k < u_observations; k++) {
        Shown s;
        if (show(t, k, told.n, s) && beside_shadows(s, told)) {
            gloss += abs(left_of(s, told.sent) - matt * s.cosine);
        }
    }
    float share = light.x / max(light.y, LEAST_LIGHT);
    Light none = told.sent;
    for (int i = 0; i < HARMONICS; i++) {
        none.c[i] = 0.0;
    }
    float turn = distance(normal_without(t, told, told.sent), normal_without(t, told, none));
    bool explains = unexplained < MOST_UNEXPLAINED * dark && gloss < MOST_GLOSS * lit && share >= LEAST_SHARE &&
                    turn >= LEAST_TURN;
    vec3 chroma = colour / max(colour.r + colour.g + colour.b, LEAST_LIGHT);
    return explains ? vec3(chroma.rg, share) : vec3(0.0);
}

bool texel_kernel(ivec2 texel)
{
    o_low = vec4(0.0);
    o_middle = vec4(0.0);
    o_high = vec4(0.0);
    if (state_at(texel) != TEXEL_SOLVED || texelFetch(u_asked, texel, 0).x == 0.0) {
        return true;
    }
    Texel t = observed_texel(texel);
    t.shadow = 0.0;
    float c[12];
    read_estimate(texel, c);
    vec3 n = vec3(c[NORMAL_COMPONENT], c[NORMAL_COMPONENT + 1], c[NORMAL_COMPONENT + 2]);
    Told told;
    if (tell(t, n, told)) {
        vec3 found = chroma_and_share(t, told);
        if (found.z > 0.0) {
            o_low = vec4(told.sent.c[0], told.sent.c[1], told.sent.c[2], told.sent.c[3]);
            o_middle = vec4(told.sent.c[4], told.sent.c[5], told.sent.c[6], told.sent.c[7]);
            o_high = vec4(told.sent.c[8], found);
        }
    }
    return true;
}
