// Visibility for GGX: masking and shadowing over 4 (n·l) (n·v). Smith 1967, Geometrical Shadowing of a Random Rough
// Surface; height-correlated: Heitz 2014, Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs,
// Eq. 72 and 99. Cycles uses this form.

// V = G / (4 n·l n·v), G = 1 / (1 + Λ(l) + Λ(v)), Λ(d) = (√(1 + α² tan²θ_d) − 1) / 2. Multiplied out, V has no division
// by a cosine and stays finite as one of them goes to 0.
float V_SmithGGX(float NoL, float NoV, float alpha)
{
    float a2 = alpha * alpha;
    float toward_light = NoV * sqrt(NoL * NoL + a2 * (1.0 - NoL * NoL));
    float toward_view = NoL * sqrt(NoV * NoV + a2 * (1.0 - NoV * NoV));
    return 0.5 / (toward_light + toward_view);
}
