/** Worker that decodes one H.265 track per message. The first message holds the addresses of the player's files. */
import { messageOf } from "../base/errors";
import type { FileAddresses } from "../files/workers";
import { decodeTrack } from "./hevc";
import type { Track } from "./mp4";

const scope = self as unknown as {
  onmessage: (event: MessageEvent<Track | { files: FileAddresses }>) => void;
  postMessage(message: object, transfer?: Transferable[]): void;
};

let files: FileAddresses = {};

scope.onmessage = async ({ data }) => {
  if ("files" in data) return void (files = data.files);
  try {
    const planes = await decodeTrack(data, files);
    scope.postMessage({ planes }, [planes.buffer]);
  } catch (error) {
    scope.postMessage({ error: messageOf(error) });
  }
};
