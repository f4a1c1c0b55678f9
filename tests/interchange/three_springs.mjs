// Turns the head of a VRM in three-vrm, without a browser, and prints where its chains of spring bones go.
//
//     node three_springs.mjs FILE FOLDER
//
// FOLDER holds node_modules/three and node_modules/@pixiv/three-vrm. Printed: {"joints": how many swing, "colliders":
// how many, "rest", "still", "turned", "after": [[3] ...] ends of the chains: as loaded, after two seconds of standing,
// at once after the head turns by 60 degrees, and two seconds later}.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";
import { join, resolve } from "node:path";

const [file, folder] = process.argv.slice(2);
const modules = join(resolve(folder), "node_modules");
const load = (...path) => import(pathToFileURL(join(modules, ...path)));
const THREE = await load("three", "build", "three.module.js");
const { GLTFLoader } = await load("three", "examples", "jsm", "loaders", "GLTFLoader.js");
const { VRMLoaderPlugin } = await load("@pixiv", "three-vrm", "lib", "three-vrm.module.js");

const loader = new GLTFLoader();
// pictures need a browser; joints do not need pictures
loader.register(() => ({ name: "no_pictures", loadTexture: () => Promise.resolve(new THREE.Texture()) }));
loader.register((parser) => new VRMLoaderPlugin(parser));
const data = readFileSync(file);
const gltf = await loader.parseAsync(data.buffer.slice(data.byteOffset, data.byteOffset + data.length), "");
const vrm = gltf.userData.vrm;
const springs = [...vrm.springBoneManager.joints];
const ends = () => {
    gltf.scene.updateMatrixWorld(true);
    return springs.filter(({ child }) => child && !child.children.length).map(({ child }) => child.getWorldPosition(new THREE.Vector3()).toArray());
};
const stand = (seconds) => { for (let k = 0; k < 60 * seconds; k += 1) vrm.update(1 / 60); };

const out = { joints: springs.length, colliders: vrm.springBoneManager.colliders.length, rest: ends() };
stand(2);
out.still = ends();
vrm.humanoid.getNormalizedBoneNode("head").rotation.set(0, Math.PI / 3, 0);
stand(1 / 60);
out.turned = ends();
stand(2);
out.after = ends();
console.log(JSON.stringify(out));
