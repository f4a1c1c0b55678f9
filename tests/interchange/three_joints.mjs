// Plays the first animation of a GLB in three.js, without a browser, and prints what its nodes do.
//
//     node three_joints.mjs FILE FOLDER SECONDS [SECONDS ...]
//
// FOLDER holds node_modules/three. Printed: {"joints": [name ...], "parents": [name or null ...],
// "inverse": [[16] ...], "rest": [[16] ...], "frames": [{"quaternions": [[4] ...], "world": [[16] ...]} ...]},
// matrices by columns.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";
import { join, resolve } from "node:path";

const [file, folder, ...seconds] = process.argv.slice(2);
const three = join(resolve(folder), "node_modules", "three");
const THREE = await import(pathToFileURL(join(three, "build", "three.module.js")));
const { GLTFLoader } = await import(pathToFileURL(join(three, "examples", "jsm", "loaders", "GLTFLoader.js")));

const loader = new GLTFLoader();
// pictures need a browser; joints do not need pictures
loader.register(() => ({ name: "no_pictures", loadTexture: () => Promise.resolve(new THREE.Texture()) }));
const data = readFileSync(file);
const gltf = await loader.parseAsync(data.buffer.slice(data.byteOffset, data.byteOffset + data.length), "");

let skeleton;
gltf.scene.traverse((node) => { if (node.isSkinnedMesh) skeleton = node.skeleton; });
const bones = skeleton.bones;
const world = () => { gltf.scene.updateMatrixWorld(true); return bones.map((bone) => bone.matrixWorld.toArray()); };

const out = {
    joints: bones.map((bone) => bone.name),
    parents: bones.map((bone) => (bones.includes(bone.parent) ? bone.parent.name : null)),
    inverse: skeleton.boneInverses.map((matrix) => matrix.toArray()),
    rest: world(),
    frames: [],
};
if (seconds.length) {
    const mixer = new THREE.AnimationMixer(gltf.scene);
    const action = mixer.clipAction(gltf.animations[0]);
    action.setLoop(THREE.LoopOnce);
    action.clampWhenFinished = true;
    action.play();
    for (const second of seconds) {
        mixer.setTime(Number(second));
        out.frames.push({ world: world(), quaternions: bones.map((bone) => bone.quaternion.toArray()) });
    }
}
console.log(JSON.stringify(out));
