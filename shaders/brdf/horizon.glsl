// Whether light and view are both above a surface's horizon.

// The components of float32 unit vectors carry rounding of up to 2⁻²⁴ = 6e-8 each, so a cosine below 1e-7 is one whose
// sign is not known: it counts as below. The bound also keeps every division by a cosine finite.
#define HORIZON 1e-7

bool above_horizon(float NoL, float NoV)
{
    return NoL > HORIZON && NoV > HORIZON;
}
