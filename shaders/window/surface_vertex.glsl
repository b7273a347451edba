// Vertex stage of a surface with a picture on it. Reads position and uv; u_toward pulls its depth toward the viewer.

void main()
{
    gl_Position = u_matrix * vec4(position, 1.0);
    gl_Position.z += u_toward;
    v_uv = uv;
}
