/** Decoding of Draco point clouds by the WASM decoder of npm draco3d. Runs in a worker. */
import { ReelError } from "../base/errors";
import { fileAddress, type FileAddresses } from "../files/workers";

interface DracoModule {
  Decoder: new () => DracoDecoder;
  PointCloud: new () => DracoCloud;
  POSITION: number;
  HEAPU8: Uint8Array;
  _malloc(bytes: number): number;
  _free(pointer: number): void;
  DT_FLOAT32: number;
  destroy(object: object): void;
}
interface DracoDecoder {
  DecodeArrayToPointCloud(bytes: Int8Array, size: number, cloud: DracoCloud): { ok(): boolean; error_msg(): string };
  GetAttributeId(cloud: DracoCloud, type: number): number;
  GetAttribute(cloud: DracoCloud, id: number): object;
  GetAttributeDataArrayForAllPoints(
    cloud: DracoCloud,
    attribute: object,
    type: number,
    bytes: number,
    pointer: number,
  ): boolean;
}
interface DracoCloud {
  num_points(): number;
}

/** Exports of draco-decode.js. */
interface DracoExport {
  default(options: object): Promise<DracoModule>;
}

let loading: Promise<DracoModule> | undefined;

function loadDraco(files: FileAddresses): Promise<DracoModule> {
  loading ??= (import(fileAddress(files, "draco-decode.js")) as Promise<DracoExport>).then((module) =>
    module.default({ locateFile: (name: string) => fileAddress(files, name) }),
  );
  return loading;
}

/** Decode positions [N, 3] in the order of the file. */
export async function decodeDraco(bytes: Uint8Array, files: FileAddresses): Promise<Float32Array> {
  // Accept only clouds with one attribute of three numbers, since others take more memory.
  if (bytes.length < 21 || bytes[15] !== 1 || bytes[16] !== 1 || bytes[19] !== 3)
    throw new ReelError("The point cloud of a file has other attributes than positions.");
  const draco = await loadDraco(files);
  const decoder = new draco.Decoder();
  const cloud = new draco.PointCloud();
  try {
    const status = decoder.DecodeArrayToPointCloud(new Int8Array(bytes.slice().buffer), bytes.byteLength, cloud);
    if (!status.ok()) throw new ReelError(`The positions of a file cannot be decoded (${status.error_msg()}).`);
    const id = decoder.GetAttributeId(cloud, draco.POSITION);
    if (id < 0) throw new ReelError("The point cloud of a file has no positions.");
    const attribute = decoder.GetAttribute(cloud, id);
    const size = cloud.num_points() * 12;
    const pointer = draco._malloc(size);
    decoder.GetAttributeDataArrayForAllPoints(cloud, attribute, draco.DT_FLOAT32, size, pointer);
    const result = new Float32Array(draco.HEAPU8.slice(pointer, pointer + size).buffer);
    draco._free(pointer);
    return result;
  } finally {
    draco.destroy(cloud);
    draco.destroy(decoder);
  }
}
