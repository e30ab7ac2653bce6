// Written by tools/vendor.py, for tsc only.
export { default as URDFLoader } from 'urdf-loader';
export { ColladaLoader } from 'three/examples/jsm/loaders/ColladaLoader.js';
export { OBJLoader } from 'three/examples/jsm/loaders/OBJLoader.js';
export { STLLoader } from 'three/examples/jsm/loaders/STLLoader.js';
