/* Shows the filmed and the fitted motion side by side. A slider selects the picture of the video, and moves
 * the mark in the curves. The page and saved files use the same script. */
'use strict';
(() => {
  function compare(root) {
    const [video, slider, said, play] = ['video', 'input[type=range]', 'output', 'button'].map((one) => root.querySelector(one));
    const marks = root.querySelectorAll('.now'), fps = Number(root.dataset.fps), times = root.dataset.times.split(' ').map(Number);
    const say = () => {
      const n = Number(slider.value);
      said.textContent = `${n + 1} of ${times.length}, ${times[n].toFixed(2)} s`;
      for (const mark of marks) mark.setAttribute('transform', `translate(${mark.dataset.places.split(' ')[n]} 0)`);
    };
    // Seek to the middle of a picture: at its beginning, a browser may show the previous picture.
    slider.addEventListener('input', () => { video.pause(); video.currentTime = (Number(slider.value) + 0.5) / fps; say(); });
    const follow = () => {
      if (video.paused) return;
      slider.value = Math.min(times.length - 1, Math.floor(video.currentTime * fps));
      say();
      requestAnimationFrame(follow);
    };
    play.addEventListener('click', () => (video.paused ? video.play() : video.pause()));
    video.addEventListener('play', () => { play.textContent = 'Pause'; follow(); });
    video.addEventListener('pause', () => { play.textContent = 'Play'; });
    say();
  }

  globalThis.Phy124Compare = compare;
})();
