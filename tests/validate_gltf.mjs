// Runs the Khronos glTF validator on one file and prints its report as JSON.
//
//     node tests/validate_gltf.mjs FILE [FOLDER]
//
// FOLDER holds node_modules/gltf-validator (`npm install gltf-validator`); without it the usual search applies.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join, resolve } from "node:path";

const [file, folder] = process.argv.slice(2);
const require = createRequire(folder ? join(resolve(folder), "package.json") : import.meta.url);
const validator = require("gltf-validator");
const report = await validator.validateBytes(new Uint8Array(readFileSync(file)), { uri: file, maxIssues: 100 });
console.log(JSON.stringify(report));
