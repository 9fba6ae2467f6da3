/** Icons as SVG markup, drawn on 24 x 24. */
const icon = (body: string): string => `<svg viewBox="0 0 24 24" aria-hidden="true">${body}</svg>`;

export const PLAY = icon('<path class="solid" d="M8 5.5v13l10.5-6.5z"/>');
export const PAUSE = icon('<path d="M8.5 5.5v13M15.5 5.5v13" stroke-width="3"/>');
export const RESET = icon('<path d="M4 12a8 8 0 1 0 2.6-5.9L4 8.5M4 4v4.5h4.5"/>');
export const SETTINGS = icon(
  '<path d="M4 7h9M19 7h1M4 17h1M11 17h9"/><circle cx="16" cy="7" r="2.5"/><circle cx="8" cy="17" r="2.5"/>',
);
export const CAPTIONS = icon(
  '<rect x="3.5" y="5.5" width="17" height="13" rx="2.5"/><path d="M10.5 10.3a2.2 2.2 0 1 0 0 3.4M16.8 10.3a2.2 2.2 0 1 0 0 3.4"/>',
);
export const FULL = icon('<path d="M9 4H4v5M15 4h5v5M9 20H4v-5M15 20h5v-5"/>');
export const SMALL = icon('<path d="M4 9h5V4M20 9h-5V4M4 15h5v5M20 15h-5v5"/>');
export const HEADSET = icon(
  '<path d="M3 8.5A2.5 2.5 0 0 1 5.5 6h13A2.5 2.5 0 0 1 21 8.5v7a2.5 2.5 0 0 1-2.5 2.5h-2.6a2 2 0 0 1-1.6-.8l-1.1-1.5a1.5 1.5 0 0 0-2.4 0l-1.1 1.5a2 2 0 0 1-1.6.8H5.5A2.5 2.5 0 0 1 3 15.5z"/>',
);
export const CUBE = icon(
  '<path d="M12 3.5 19.5 7.8v8.4L12 20.5l-7.5-4.3V7.8zM12 12l7.5-4.2M12 12v8.5M12 12 4.5 7.8"/>',
);
export const BACK = icon('<path d="M14.5 6.5 9 12l5.5 5.5"/>');
export const ON = icon('<path d="M9.5 6.5 15 12l-5.5 5.5"/>');
export const CLOSE = icon('<path d="M6.5 6.5l11 11M17.5 6.5l-11 11"/>');
export const HAND = icon(
  '<path d="M9 11.5V5.2a1.5 1.5 0 0 1 3 0V11m0-.7V9.6a1.5 1.5 0 0 1 3 0v1.2m0-.2a1.5 1.5 0 0 1 3 0v4.4a5.5 5.5 0 0 1-5.5 5.5h-1a5.5 5.5 0 0 1-4.4-2.3L5.6 15a1.5 1.5 0 0 1 2.2-2L9 14" fill="rgb(0 0 0 / 0.35)"/>',
);
const SPEAKER = '<path class="solid" d="M4 9.5h3.5L12 5.5v13l-4.5-4H4z"/>';
export const SOUND = icon(`${SPEAKER}<path d="M15.5 9a4.2 4.2 0 0 1 0 6M18 6.5a7.8 7.8 0 0 1 0 11"/>`);
export const MUTED = icon(`${SPEAKER}<path d="M15.5 9.5l5 5M20.5 9.5l-5 5"/>`);
