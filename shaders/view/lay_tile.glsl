// Over the picture of a whole domain, possibly at reduced size: copies a tile's own texels and leaves all others.
// Reads u_tile, the picture of the tile with its halo. u_x, u_y: origin of u_tile in the domain; u_left to u_top: the
// tile's own texels; u_across, u_up: domain texels per texel of the picture.

bool texel_kernel(ivec2 texel)
{
    ivec2 place = ivec2((vec2(texel) + 0.5) * vec2(u_across, u_up));
    if (any(lessThan(place, ivec2(u_left, u_bottom))) || any(greaterThanEqual(place, ivec2(u_right, u_top)))) {
        return false;
    }
    o_picture = texelFetch(u_tile, place - ivec2(u_x, u_y), 0);
    return true;
}
