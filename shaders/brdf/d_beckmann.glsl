// Distribution of microfacet normals. Beckmann & Spizzichino 1963, The Scattering of Electromagnetic Waves from Rough
// Surfaces; in the form of Cook & Torrance 1982, A Reflectance Model for Computer Graphics, Eq. 7, with the 1/π that
// ∫ D (n·h) dω = 1 needs.

// D = exp(−tan²θ_h / m²) / (π m² cos⁴θ_h).
// NoH > 0, sin2_h = 1 − NoH² (given apart: see angles.glsl), m > 0 the root mean square slope.
float D_Beckmann(float NoH, float sin2_h, float m)
{
    float cos2 = NoH * NoH;
    float m2 = m * m;
    return exp(-sin2_h / (cos2 * m2)) / (3.14159265358979 * m2 * cos2 * cos2);
}
