// Vertex stage of a bake. Reads place (clip coordinates before the division) and corner (3 · triangle + 0, 1 or 2).
// Passes on the number of the triangle.

void main()
{
    gl_Position = place;
    v_triangle = corner / 3;
}
