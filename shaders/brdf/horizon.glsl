// Tests whether light and view are both above the horizon of a surface.

// Each component of a float32 unit vector has a rounding error of up to 2⁻²⁴ = 6e-8. The sign of a cosine below 1e-7 is
// unknown, so it counts as below. The bound also keeps every division by a cosine finite.
#define HORIZON 1e-7

bool above_horizon(float NoL, float NoV)
{
    return NoL > HORIZON && NoV > HORIZON;
}
