// Whether three.js has the joints of motion.glb where motion.json says they are; see `skeletons.py glb`.
import { readFileSync } from "node:fs";
import * as THREE from "three";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";

globalThis.self = globalThis;

const bytes = readFileSync("motion.glb");
const want = JSON.parse(readFileSync("motion.json", "utf-8"));
const buffer = bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
const file = await new Promise((done, failed) => new GLTFLoader().parse(buffer, "", done, failed));
const mixer = new THREE.AnimationMixer(file.scene);
mixer.clipAction(file.animations[0]).play();
mixer.setTime(want.seconds);
file.scene.updateMatrixWorld(true);
const off = want.joints.map((name, i) => {
  const place = new THREE.Vector3().setFromMatrixPosition(file.scene.getObjectByName(name).matrixWorld);
  return place.distanceTo(new THREE.Vector3(...want.places_m[i]));
});
console.log(`three.js r${THREE.REVISION}: joints at most ${(1000 * Math.max(...off)).toFixed(5)} mm off`);
