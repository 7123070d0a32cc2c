/** Unpacks what the page knows and its scripts, and runs them. */
import { unpacked } from "./unpack.js";

const part = (id) => document.getElementById(id);

try {
  if (!("DecompressionStream" in globalThis)) throw new Error("it needs a browser of 2023 or newer");
  for (const id of ["data", "worker"]) part(id).textContent = await unpacked(id).text();
  const script = Object.assign(document.createElement("script"), { type: "module", textContent: await unpacked("main").text() });
  part("main").replaceWith(script);
} catch (error) {
  part("message").textContent = `The explorer cannot run here: ${error.message}.`;
  part("message").hidden = false;
}
