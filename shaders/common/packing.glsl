// Solved texels lie densely packed in all textures of a recovery. Reads u_place (the domain's texel of a packed one)
// and u_packed (the packed texel of a domain's, −1 where none is solved).

ivec2 place_of(ivec2 packed_texel)
{
    return ivec2(texelFetch(u_place, packed_texel, 0).xy);
}

// Returns the packed texel, or (−1, −1) outside the domain and where nothing is solved.
ivec2 packed_at(ivec2 place)
{
    if (any(lessThan(place, ivec2(0))) || any(greaterThanEqual(place, textureSize(u_packed, 0)))) {
        return ivec2(-1);
    }
    return ivec2(texelFetch(u_packed, place, 0).xy);
}
