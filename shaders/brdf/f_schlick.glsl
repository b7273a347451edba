// Fresnel reflectance. Schlick 1994, An Inexpensive BRDF Model for Physically-Based Rendering, Eq. 15.

// F = F0 + (1 − F0) (1 − v·h)⁵. Written as a product: pow() of the slightly negative number that rounding may leave at
// v·h = 1 is undefined.
float F_Schlick(float VoH, float F0)
{
    float x = 1.0 - VoH;
    float x2 = x * x;
    return F0 + (1.0 - F0) * (x2 * x2 * x);
}
