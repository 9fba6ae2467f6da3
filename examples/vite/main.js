import "splatreel-player"; // defines <splat-reel>

const reel = document.querySelector("splat-reel");
const status = document.getElementById("status");
reel.addEventListener("canplay", () => {
  status.textContent = `${reel.duration.toFixed(1)} s`;
});
reel.addEventListener("error", () => {
  status.textContent = reel.error.message;
});
