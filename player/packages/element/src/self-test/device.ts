/** Facts about the browser, the device and its graphics. */
import type { Finding } from "./report";

/** Limits of WebGL that the renderer depends on. */
const LIMITS = [
  "MAX_TEXTURE_SIZE",
  "MAX_ARRAY_TEXTURE_LAYERS",
  "MAX_TEXTURE_IMAGE_UNITS",
  "MAX_VERTEX_TEXTURE_IMAGE_UNITS",
  "MAX_COLOR_ATTACHMENTS",
  "MAX_RENDERBUFFER_SIZE",
] as const;

/** Return the facts about the browser and the device. */
export async function deviceFacts(): Promise<Finding[]> {
  const { userAgent, hardwareConcurrency, maxTouchPoints, languages } = navigator;
  const { deviceMemory } = navigator as { deviceMemory?: number };
  const has = (name: string): string => `${name} ${name in globalThis ? "yes" : "no"}`;
  return [
    fact("Browser", userAgent),
    fact(
      "Device",
      `${hardwareConcurrency} threads, memory ${deviceMemory ? `${deviceMemory} GB or more` : "unknown"}, ${maxTouchPoints} touch points, languages ${languages.join(", ")}`,
    ),
    fact(
      "Screen",
      `${screen.width} x ${screen.height}, ${devicePixelRatio} pixels per unit, window ${innerWidth} x ${innerHeight}`,
    ),
    fact(
      "Features",
      [
        `secure context ${isSecureContext ? "yes" : "no"}`,
        has("VideoDecoder"),
        has("SharedArrayBuffer"),
        `headset ${await supports("immersive-vr")}`,
        `AR ${await supports("immersive-ar")}`,
      ].join(", "),
    ),
  ];
}

/** Return the facts about the graphics of a canvas that the player draws on. */
export function graphicsFacts(canvas: HTMLCanvasElement): Finding[] {
  const gl = canvas.getContext("webgl2");
  if (!gl) return [{ name: "WebGL", state: "failed", text: "this browser has no WebGL 2" }];
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  const renderer = String(gl.getParameter(names ? names.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  const limits = LIMITS.map(
    (name) => `${name.slice(4).toLowerCase().replaceAll("_", " ")} ${gl.getParameter(gl[name])}`,
  );
  return [fact("Graphics", renderer), fact("WebGL limits", limits.join(", "))];
}

/** Return a fact. */
export function fact(name: string, text: string): Finding {
  return { name, state: "fact", text };
}

async function supports(mode: string): Promise<string> {
  const { xr } = navigator as { xr?: { isSessionSupported(mode: string): Promise<boolean> } };
  return (await xr?.isSessionSupported(mode).catch(() => false)) ? "yes" : "no";
}
