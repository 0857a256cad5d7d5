// The part of PlayCanvas that draws Gaussians; bundled into vendor/playcanvas.min.js.
export {
  AppBase, AppOptions, BoundingBox, CameraComponentSystem, Color, Entity, FILLMODE_NONE,
  GAMMA_SRGB, GSplatComponentSystem, GSplatContainer, GSplatFormat, PIXELFORMAT_RGBA32F,
  RESOLUTION_FIXED, TONEMAP_NONE, Vec3, WORKBUFFER_UPDATE_ONCE,
  WebglGraphicsDevice,
} from 'playcanvas';
