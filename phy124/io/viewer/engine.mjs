// The part of PlayCanvas that draws Gaussians and a shader of phy124; bundled into vendor/playcanvas.min.js.
export {
  ADDRESS_CLAMP_TO_EDGE, AppBase, AppOptions, BoundingBox, CULLFACE_NONE, CameraComponentSystem, Color,
  Entity, FILLMODE_NONE, FILTER_LINEAR, FILTER_NEAREST, GAMMA_SRGB, GSplatComponentSystem,
  GSplatContainer, GSplatFormat, GraphNode, LAYERID_WORLD, Mesh, MeshInstance, PIXELFORMAT_R32F,
  PIXELFORMAT_RGBA32F, PIXELFORMAT_RGBA8, RESOLUTION_FIXED, SEMANTIC_POSITION, ShaderMaterial,
  TONEMAP_NONE, Texture, Vec3, WORKBUFFER_UPDATE_ONCE, WebglGraphicsDevice,
} from 'playcanvas';
