// Prints the Khronos validator's report on a GLB: node validate_glb.mjs FOLDER_OF_THE_VALIDATOR FILE
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";

const [folder, file] = process.argv.slice(2);
const { validateBytes } = createRequire(import.meta.url)(folder);
const report = await validateBytes(new Uint8Array(await readFile(file)), { uri: "file.glb" });
console.log(JSON.stringify(report));
