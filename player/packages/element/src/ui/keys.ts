/** Keyboard control. One table defines the keys. */
import type { Motion } from "../camera/motion";
import type { Player } from "../player/player";
import { skip } from "./skip";

/** Actions of the controls that keys trigger. Those that return false had no effect. */
export interface Actions {
  toggle(): boolean;
  fullscreen(): void;
  headset(): boolean;
  reset(): void;
  fly(): void;
  walk(): void;
  section(): void;
  statistics(): void;
  volume(steps: number): void;
  context(): void;
  picture(): void;
  help(): void;
  escape(): boolean;
}

interface Binding {
  /** As `KeyboardEvent.key` in lower case, with "shift+" for arrows. */
  keys: string[];
  /** Returns false if the key had no effect, so that the browser and the page may use it. */
  press?: (key: string) => unknown;
  /** Velocity of the camera while the key is pressed. */
  thrust?: Partial<Motion>;
}

/** Keys that belong together. help.ts describes them, by the first one. */
interface Line {
  /** Returns true if the line applies to the reel; without it, it always does. */
  applies?: () => boolean;
  /** True if the keys work without a reel. */
  always?: boolean;
  bindings: Binding[];
}

/** Velocities per second: radians, pivot distances, and powers of e. */
const TURN = 1.2;
const WALK = 0.6;
const ZOOM = 1.2;
const RATES = [0.25, 0.5, 0.75, 1, 1.25, 1.5, 2];

/** Keys for time and for the view. */
export type KeyTable = [time: Line[], view: Line[]];

/** Listen for keys until the signal. host: the element, or the whole bundled page. Returns the table for the help. */
export function attachKeys(host: HTMLElement, player: Player, actions: Actions, signal: AbortSignal): KeyTable {
  const table: KeyTable = [timeLines(player, actions), viewLines(player, actions)];
  const bindings = new Map<string, Binding & { line: Line }>();
  for (const line of table.flat())
    for (const binding of line.bindings) for (const key of binding.keys) bindings.set(key, { ...binding, line });
  const down = new Map<string, Partial<Motion>>();
  const steer = (): void => {
    const thrust: Motion = { yaw: 0, pitch: 0, right: 0, down: 0, forward: 0, zoom: 0 };
    for (const part of down.values())
      for (const [axis, value] of Object.entries(part)) thrust[axis as keyof Motion] += value;
    player.camera?.steer(thrust);
  };
  host.addEventListener(
    "keydown",
    (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented || takesKeys(event)) return;
      const key = nameOf(event);
      const binding = bindings.get(key);
      if (!binding || binding.line.applies?.() === false) return;
      if (!player.manifest && !binding.line.always) return;
      if (binding.press?.(key) === false) return;
      event.preventDefault();
      if (binding.thrust) down.set(event.code, binding.thrust);
      steer();
    },
    { signal },
  );
  host.addEventListener("keyup", (event) => (down.delete(event.code), steer()), { signal });
  const letGo = (): void => (down.clear(), steer());
  host.addEventListener("focusout", letGo, { signal });
  addEventListener("blur", letGo, { signal });
  return table;
}

/** Return true if the focused element handles this key itself. */
function takesKeys(event: KeyboardEvent): boolean {
  const { key } = event;
  const target = event.composedPath()[0];
  if (!(target instanceof HTMLElement) || key === "Escape") return false;
  if (target.isContentEditable || target.matches("select, textarea, input:not([type=range], [type=checkbox])"))
    return true;
  if (target.matches("[type=checkbox]")) return key === " ";
  return target.matches("button, summary, a[href]") && (key === " " || key === "Enter");
}

function nameOf({ key, shiftKey }: KeyboardEvent): string {
  return (key.startsWith("Arrow") || key === "F10") && shiftKey ? `shift+${key.toLowerCase()}` : key.toLowerCase();
}

function timeLines(player: Player, actions: Actions): Line[] {
  const move = (part: number, most: number) => (): void => skip(player, part, most);
  const { soundtrack } = player;
  const hasSound = (): boolean => soundtrack.available;
  const rate = (step: number) => (): void => {
    const nearest = RATES.findIndex((value) => value >= player.playbackRate);
    player.playbackRate = RATES[Math.min(Math.max(nearest + step, 0), RATES.length - 1)];
  };
  return [
    { always: true, bindings: [{ keys: [" ", "k"], press: actions.toggle }] },
    {
      bindings: [
        { keys: ["arrowleft"], press: move(-0.1, 5) },
        { keys: ["arrowright"], press: move(0.1, 5) },
      ],
    },
    {
      bindings: [
        { keys: ["j"], press: move(-0.2, 10) },
        { keys: ["l"], press: move(0.2, 10) },
      ],
    },
    {
      bindings: [
        { keys: [","], press: () => player.step(-1) },
        { keys: ["."], press: () => player.step(1) },
      ],
    },
    {
      bindings: [
        {
          keys: [..."0123456789"],
          press: (key) =>
            void (player.currentTime = player.earliest + (Number(key) / 10) * (player.duration - player.earliest)),
        },
      ],
    },
    {
      bindings: [
        { keys: ["home"], press: () => void (player.currentTime = player.earliest) },
        { keys: ["end"], press: () => void (player.currentTime = player.duration) },
      ],
    },
    {
      applies: () => (player.tracks?.chapters.length ?? 0) > 0,
      bindings: [
        { keys: ["b"], press: () => player.tracks?.step(-1) },
        { keys: ["n"], press: () => player.tracks?.step(1) },
      ],
    },
    {
      applies: () => (player.tracks?.captions.length ?? 0) > 0,
      bindings: [{ keys: ["t"], press: () => player.tracks?.toggle() }],
    },
    {
      bindings: [
        { keys: ["<"], press: rate(-1) },
        { keys: [">"], press: rate(1) },
      ],
    },
    { bindings: [{ keys: ["o"], press: actions.section }] },
    {
      applies: hasSound,
      bindings: [
        { keys: ["arrowup"], press: () => actions.volume(1) },
        { keys: ["arrowdown"], press: () => actions.volume(-1) },
      ],
    },
    { always: true, bindings: [{ keys: ["m"], press: () => player.soundtrack.toggle() }] },
  ];
}

function viewLines(player: Player, actions: Actions): Line[] {
  const both = (keys: [string, string], axis: keyof Motion, speed: number): Binding[] => [
    { keys: [keys[0]], thrust: { [axis]: -speed } },
    { keys: [keys[1]], thrust: { [axis]: speed } },
  ];
  return [
    { bindings: [...both(["s", "w"], "forward", WALK), ...both(["a", "d"], "right", WALK)] },
    { bindings: both(["e", "q"], "down", WALK) },
    {
      bindings: [
        ...both(["shift+arrowleft", "shift+arrowright"], "yaw", TURN),
        ...both(["shift+arrowup", "shift+arrowdown"], "pitch", TURN),
      ],
    },
    { bindings: [...both(["+", "-"], "zoom", ZOOM), { keys: ["="], thrust: { zoom: -ZOOM } }] },
    {
      bindings: [
        { keys: ["["], press: () => player.camera?.visit(-1) },
        { keys: ["]"], press: () => player.camera?.visit(1) },
      ],
    },
    { bindings: [{ keys: ["c"], press: actions.fly }] },
    { bindings: [{ keys: ["g"], press: actions.walk }] },
    { bindings: [{ keys: ["r"], press: actions.reset }] },
    { always: true, bindings: [{ keys: ["f"], press: actions.fullscreen }] },
    { bindings: [{ keys: ["v"], press: actions.headset }] },
    { bindings: [{ keys: ["p"], press: actions.picture }] },
    { bindings: [{ keys: ["i"], press: actions.statistics }] },
    { always: true, bindings: [{ keys: ["?"], press: actions.help }] },
    { bindings: [{ keys: ["shift+f10", "contextmenu"], press: actions.context }] },
    { always: true, bindings: [{ keys: ["escape"], press: actions.escape }] },
  ];
}
