/** Captions and chapters of a reel, given by the `<track>` children of its element. A part that is loaded on demand implements them. */

/** A chapter: its title, and its start and end in seconds. */
export interface Chapter {
  title: string;
  start: number;
  end: number;
}

/** Captions to choose from, and chapters. */
export interface TextTracks {
  /** Names of the captions. */
  readonly captions: string[];
  /** Index of the captions that are shown; -1 for none. */
  shown: number;
  /** Chapters in order of their start. */
  readonly chapters: readonly Chapter[];
  /** Index of the chapter at a time in seconds; -1 for none. */
  chapterAt(seconds: number): number;
  /** Show or hide the captions. */
  toggle(): void;
  /** Go to the next chapter, or to the previous one. */
  step(chapters: 1 | -1): void;
}
