// A reel and a box that turns in front of it.
import { Canvas, useFrame } from "@react-three/fiber";
import React, { useRef, useState } from "react";
import { Reel } from "./Reel.jsx";

const OPTIONS = { loop: true, autoplay: true, muted: true };

function Box() {
  const mesh = useRef();
  useFrame((state, seconds) => (mesh.current.rotation.y += seconds));
  return (
    <mesh ref={mesh} position={[0, 0.5, 0]} scale={0.3}>
      <boxGeometry />
      <meshStandardMaterial color="orange" />
    </mesh>
  );
}

export function App() {
  const [reel, setReel] = useState(null);
  return (
    <>
      <Canvas onClick={() => reel && (reel.paused ? reel.play() : reel.pause())}>
        <hemisphereLight intensity={3} />
        <Reel src="reel/manifest.json" options={OPTIONS} onReady={setReel} />
        <Box />
      </Canvas>
      <output id="status">{reel ? `${reel.duration.toFixed(1)} s` : "Loading …"}</output>
    </>
  );
}
