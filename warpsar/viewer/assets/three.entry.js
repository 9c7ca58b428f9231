// What viewer.js takes of three.js. three.min.js is made of this file (README.md beside it says how).
export {
  ArrowHelper, BufferAttribute, BufferGeometry, CanvasTexture, Color, DataTexture, DepthTexture, DoubleSide, GLSL3, GridHelper, Group,
  LinearFilter, Matrix4, Mesh, MeshBasicMaterial, NearestFilter, OrthographicCamera, PerspectiveCamera, Raycaster, RGBAFormat, Scene, ShaderMaterial,
  Sprite, SpriteMaterial, Texture, Vector2, Vector3, WebGLRenderer, WebGLRenderTarget,
} from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
