import { SplatReel } from "@splatreel/playcanvas";
import * as pc from "playcanvas";
import { measure, settle } from "./orbit.js";
import { app, canvas, pose } from "./playcanvas-app.js";

const entity = new pc.Entity();
entity.addComponent("script");
const reel = entity.script.create(SplatReel, { properties: { url: "reel/manifest.json" } });
app.root.addChild(entity);
const sorts = [];
app.scene.on("gsplat:sorted", (milliseconds) => sorts.push(milliseconds));
app.start();
await reel.whenReady();
window.bench = { reel, measure: () => measure(pose, canvas), settle: (viewmat) => settle(pose, viewmat, 30), sorts: () => sorts, canvas };
