// The panels' captions and legends.

import { colour, short } from './colours.js';

const STOPS = 32;

export class Panel {
  constructor(element) {
    this.element = element;
    this.caption = element.querySelector('.caption');
    this.legend = element.querySelector('.legend');
    this.bar = element.querySelector('canvas');
    [this.low, this.label, this.high] = element.querySelectorAll('.legend span');
    this.bar.width = STOPS;
    this.bar.height = 1;
  }

  /** Sets the caption; null hides the panel. */
  name(caption) {
    this.element.hidden = caption === null;
    this.caption.textContent = caption ?? '';
    this.legend.hidden = true;
  }

  /** Shows the colours of a range. */
  scale(stops, [low, high], label) {
    this.legend.hidden = false;
    [this.low.textContent, this.high.textContent] = [short(low), short(high)];
    this.label.textContent = label;
    this.colours = { stops, range: [short(low), short(high)], label };
    const context = this.bar.getContext('2d');
    for (let x = 0; x < STOPS; x++) {
      context.fillStyle = `rgb(${colour(stops, x / (STOPS - 1)).join(' ')})`;
      context.fillRect(x, 0, 1, 1);
    }
  }
}
