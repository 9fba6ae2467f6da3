/** Decodes one H.265 track per message. */
import { messageOf } from "../base/errors";
import { decodeTrack } from "./hevc";
import type { Track } from "./mp4";

const scope = self as unknown as { onmessage: (event: MessageEvent<Track>) => void; postMessage(message: object, transfer?: Transferable[]): void };

scope.onmessage = async ({ data: track }) => {
  try {
    const planes = await decodeTrack(track);
    scope.postMessage({ planes }, [planes.buffer]);
  } catch (error) {
    scope.postMessage({ error: messageOf(error) });
  }
};
