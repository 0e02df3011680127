// Lays out every graph of the list on standard input with elkjs, and writes the list with coordinates.
import {createRequire} from "node:module";
import {readFileSync} from "node:fs";

const require = createRequire(import.meta.url); // which looks along NODE_PATH, as import does not
const elk = new (require("elkjs"))();
const laidOut = [];
for (const graph of JSON.parse(readFileSync(0, "utf8"))) laidOut.push(await elk.layout(graph));
process.stdout.write(JSON.stringify(laidOut));
