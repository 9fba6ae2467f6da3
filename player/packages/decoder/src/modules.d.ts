// Modules that TypeScript cannot read: kernels as bytes, and the parts of Node that the decoder uses.
declare module "*.wasm" {
  const bytes: Uint8Array<ArrayBuffer>;
  export default bytes;
}

declare module "node:fs" {
  export function readFileSync(path: string): Uint8Array<ArrayBuffer>;
  export function statSync(path: string, options: { throwIfNoEntry: false }): { isFile(): boolean } | undefined;
}

declare module "node:module" {
  export function createRequire(address: string): unknown;
}

declare module "node:path" {
  export function dirname(path: string): string;
  export function join(...parts: string[]): string;
}

declare module "node:url" {
  export function fileURLToPath(address: string | URL): string;
}

declare module "node:worker_threads" {
  interface Port {
    on(event: "message" | "error", call: (value: unknown) => void): void;
    postMessage(message: unknown, transfer?: unknown[]): void;
  }
  export const parentPort: Port | null;
  export const workerData: unknown;
  /** A thread. */
  export class Worker implements Port {
    constructor(script: URL, options: { workerData: unknown });
    on(event: "message" | "error", call: (value: unknown) => void): void;
    postMessage(message: unknown, transfer?: unknown[]): void;
    terminate(): Promise<number>;
  }
}
