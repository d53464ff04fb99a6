// node validate.mjs FILE…: fails where the Khronos validator finds an error or a warning; prints what it finds.
import { readFile } from "node:fs/promises";
import { validateBytes } from "gltf-validator";

const SEVERITIES = ["error", "warning", "info", "hint"];
let failed = process.argv.length < 3;
for (const path of process.argv.slice(2)) {
  const bytes = new Uint8Array(await readFile(path));
  const report = await validateBytes(bytes, { maxIssues: 50 });
  const { numErrors, numWarnings, numInfos, numHints, messages } = report.issues;
  console.log(`${path}: ${numErrors} errors, ${numWarnings} warnings, ${numInfos} infos, ${numHints} hints`);
  for (const { severity, code, message, pointer } of messages) {
    console.log(`  ${SEVERITIES[severity]} ${code} at ${pointer}: ${message}`);
  }
  failed ||= numErrors + numWarnings > 0;
}
process.exitCode = failed ? 1 : 0;
