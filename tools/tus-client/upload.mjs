// node upload.mjs SERVER FILE: uploads the file in pieces of 512 KiB, goes on after cuts, prints the upload's address.
import { createReadStream, statSync } from "node:fs";
import { Upload } from "tus-js-client";

const [server, file] = process.argv.slice(2);
const upload = new Upload(createReadStream(file), {
  endpoint: `${server}/v1/uploads`,
  chunkSize: 512 * 1024,
  uploadSize: statSync(file).size,
  retryDelays: Array(60).fill(250),
  metadata: { filename: "clip" },
  // Slow enough to be interrupted.
  onChunkComplete: () => Atomics.wait(new Int32Array(new SharedArrayBuffer(4)), 0, 0, 60),
  onError: (error) => {
    console.error(error.message);
    process.exit(1);
  },
  onSuccess: () => console.log(upload.url),
});
upload.start();
