/** The panel of the self-test: a list of tests that are ticked off, the present instruction, and the result. */
import { copyText } from "../ui/copy-text";
import { elementOf } from "../ui/markup";
import type { Finding } from "./report";

const MARKS = { passed: "✓", failed: "✗", skipped: "–", fact: "" };

const MARKUP = `<section class="panel" aria-label="Self-test">
  <ol></ol>
  <p class="now" role="status"></p>
  <div class="buttons"></div>
  <div class="result" hidden>
    <label for="report">Result</label>
    <textarea id="report" rows="8" readonly spellcheck="false"></textarea>
    <div class="buttons"><button type="button" class="copy">Copy</button><a href="./">Open the player</a></div>
    <p class="copied" role="status"></p>
  </div>
</section>`;

/** The panel of the page. */
export class Panel {
  readonly box = elementOf(MARKUP);

  /** names: of the tests, in order. */
  constructor(names: string[]) {
    this.find("ol").append(...names.map((name) => Object.assign(document.createElement("li"), { textContent: name })));
  }

  /** Show an instruction, and mark its test as the present one. */
  instruct(index: number, words: string): void {
    for (const [i, item] of [...this.find("ol").children].entries()) item.ariaCurrent = i === index ? "step" : null;
    this.find(".now").textContent = words;
  }

  /** Offer buttons before those that are there. Resolves to the text of the one that people press; never if the signal comes first. */
  choose(labels: string[], signal: AbortSignal): Promise<string> {
    return new Promise((resolve) => {
      const buttons = labels.map((label) =>
        Object.assign(document.createElement("button"), { type: "button", textContent: label }),
      );
      const remove = (): void => buttons.forEach((button) => button.remove());
      for (const button of buttons) {
        button.onclick = () => {
          remove();
          resolve(button.textContent!);
        };
      }
      this.find(".buttons").prepend(...buttons);
      signal.addEventListener("abort", remove);
    });
  }

  /** Tick a test off. */
  tick(index: number, state: Finding["state"]): void {
    const item = this.find("ol").children[index] as HTMLElement;
    item.className = state;
    item.dataset.mark = MARKS[state];
    item.ariaLabel = `${item.textContent}: ${state}`;
  }

  /** Show the result. */
  finish(report: string): void {
    this.instruct(-1, "Copy the result into an issue. Check it first: it names your browser and device.");
    const area = this.find<HTMLTextAreaElement>("textarea");
    area.value = report;
    area.onfocus = () => area.select();
    this.find(".result").hidden = false;
    this.find("a").setAttribute("href", `./${location.search}`);
    this.find(".copy").onclick = async () => {
      this.find(".copied").textContent = (await copyText(area))
        ? "Copied"
        : "Selected: copy it with the browser's menu";
    };
    this.find(".copy").focus();
  }

  private find<T extends HTMLElement>(selector: string): T {
    return this.box.querySelector<T>(selector)!;
  }
}
