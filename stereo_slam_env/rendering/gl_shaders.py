"""What the GL back end computes for each vertex and each pixel, in GLSL.

Row 0 of the frame buffer is row 0 of the image, so nothing has to be flipped when it is read.
"""

SURFACE_VERTEX = """
#version 330
uniform mat3 R_sb;         // from the frame of the body to S; the identity for what stands still
uniform vec3 from_camera;  // origin of the body minus the left camera, in S; in two parts so that single precision
uniform vec3 remainder;    // is enough far from the origin
uniform mat3 R_cs;
uniform float eye;         // where the eye is along the camera's x axis
uniform mat4 projection;
uniform vec3 sun;          // unit vector in S
uniform vec2 light;        // ambient, diffuse
in vec3 position;
in vec3 normal;
in vec3 texel;             // u, v, layer
in vec3 color;
out vec3 at_texel;
out vec3 tint;
void main() {
    vec3 p_c = R_cs * ((R_sb * position + from_camera) + remainder);
    gl_Position = projection * vec4(p_c.x - eye, p_c.yz, 1.0);
    at_texel = texel;
    tint = color * (light.x + light.y * max(0.0, dot(R_sb * normal, sun)));
}
"""

SURFACE_FRAGMENT = """
#version 330
uniform sampler2DArray textures;
uniform vec3 horizon;
uniform float haze;        // 1/m
in vec3 at_texel;
in vec3 tint;
out vec4 shade;
void main() {
    vec3 lit = min(texture(textures, at_texel).rgb * tint, 1.0);
    shade = vec4(mix(horizon, lit, exp(-haze / gl_FragCoord.w)), 1.0);
}
"""

SKY_VERTEX = """
#version 330
void main() {  // one triangle over everything, as far away as can be
    gl_Position = vec4(gl_VertexID == 2 ? 3.0 : -1.0, gl_VertexID == 1 ? 3.0 : -1.0, 1.0, 1.0);
}
"""

SKY_FRAGMENT = """
#version 330
uniform vec3 slope;        // of the ray through a place in the frame buffer: slope.x * x + slope.y * y + slope.z
uniform vec3 horizon;
uniform vec3 zenith;
out vec4 shade;
void main() {
    float height = sqrt(clamp(dot(slope, vec3(gl_FragCoord.xy, 1.0)), 0.0, 1.0));
    shade = vec4(mix(horizon, zenith, height), 1.0);
}
"""
